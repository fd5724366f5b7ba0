//! meshopt's decoders into memory that is there already; the crate's own functions ask for new memory each time.

use bytemuck::Pod;
use meshopt::ffi;

/// Unpacks as many vertices as `out` has; false where the bytes are not that.
#[allow(unsafe_code)]
pub(super) fn vertices<T: Pod>(bytes: &[u8], out: &mut [T]) -> bool {
    // The codec's own limits, which it takes for granted.
    assert!(size_of::<T>().is_multiple_of(4) && size_of::<T>() <= 256);
    // SAFETY: it writes `out.len()` items of `T`'s size to `out`, which has them and may hold any bits, reads inside `bytes`
    // only, whatever they are, and keeps neither.
    let code = unsafe {
        ffi::meshopt_decodeVertexBuffer(out.as_mut_ptr().cast(), out.len(), size_of::<T>(), bytes.as_ptr(), bytes.len())
    };
    code == 0
}

/// Unpacks as many indices as `out` has, a multiple of 3; false where the bytes are not that.
#[allow(unsafe_code)]
pub(super) fn indices(bytes: &[u8], out: &mut [u16]) -> bool {
    assert!(out.len().is_multiple_of(3));
    // SAFETY: it writes `out.len()` indices of two bytes to `out`, which has them, reads inside `bytes` only, whatever they are,
    // and keeps neither.
    let code = unsafe {
        ffi::meshopt_decodeIndexBuffer(
            out.as_mut_ptr().cast(),
            out.len(),
            size_of::<u16>(),
            bytes.as_ptr(),
            bytes.len(),
        )
    };
    code == 0
}
