//! Accessors of a glTF document as plain lists. Every range is checked before it is read.

use super::super::error::{ImportError, Refusal, damaged, refused};
use super::buffers::Buffers;
use super::document::{Accessor, Document};

/// Most elements of an accessor that has no bytes of its own: all zero, but for sparse values.
const MAX_ZERO_COUNT: u64 = 1 << 22;

/// A component type: its size in bytes, and what makes a normalised value of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    /// From the number that the format has for it.
    fn from_code(code: u32) -> Option<Component> {
        const FIRST_CODE: u32 = 5120;
        let table = [
            Some(Component::I8),
            Some(Component::U8),
            Some(Component::I16),
            Some(Component::U16),
            None,
            Some(Component::U32),
            Some(Component::F32),
        ];
        table.get(code.checked_sub(FIRST_CODE)? as usize).copied().flatten()
    }

    fn size(self) -> usize {
        match self {
            Component::I8 | Component::U8 => 1,
            Component::I16 | Component::U16 => 2,
            Component::U32 | Component::F32 => 4,
        }
    }

    /// The value at the beginning of `bytes`.
    fn read(self, bytes: &[u8]) -> f64 {
        match self {
            Component::I8 => f64::from(bytes[0] as i8),
            Component::U8 => f64::from(bytes[0]),
            Component::I16 => f64::from(i16::from_le_bytes([bytes[0], bytes[1]])),
            Component::U16 => f64::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            Component::U32 => f64::from(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
            Component::F32 => f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
        }
    }

    /// What a normalised value is divided by.
    fn one(self) -> f64 {
        match self {
            Component::I8 => 127.0,
            Component::U8 => 255.0,
            Component::I16 => 32767.0,
            Component::U16 => 65535.0,
            Component::U32 => 4_294_967_295.0,
            Component::F32 => 1.0,
        }
    }
}

/// Components of an element by the name of its shape.
fn components(shape: &str) -> Option<usize> {
    [("SCALAR", 1), ("VEC2", 2), ("VEC3", 3), ("VEC4", 4)].iter().find(|s| s.0 == shape).map(|s| s.1)
}

/// A checked range of elements.
struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
}

/// Reads accessors.
pub(super) struct Reader<'a> {
    pub(super) name: &'a str,
    pub(super) document: &'a Document,
    pub(super) buffers: &'a Buffers<'a>,
}

impl<'a> Reader<'a> {
    /// The accessor of an index, for its count and shape.
    pub(super) fn accessor(&self, index: usize) -> Result<&'a Accessor, ImportError> {
        let accessors = &self.document.accessors;
        accessors.get(index).ok_or_else(|| {
            damaged(self.place(index), format!("is referred to, but there are only {} accessors", accessors.len()))
        })
    }

    /// Elements with up to N components, normalised where the accessor says so; missing components are `fill`.
    pub(super) fn vectors<const N: usize>(
        &self,
        index: usize,
        least: usize,
        fill: f64,
    ) -> Result<Vec<[f64; N]>, ImportError> {
        let accessor = self.accessor(index)?;
        let (component, width) = self.layout(index, accessor)?;
        if width < least || width > N {
            let what = format!("has elements of the shape {}, which do not fit its use", accessor.shape);
            return Err(damaged(self.place(index), what));
        }
        let scale = if accessor.normalized { component.one() } else { 1.0 };
        // Signed normalised values have two codes for -1.
        let lowest = if accessor.normalized { -1.0 } else { f64::NEG_INFINITY };
        let size = component.size();
        let read =
            |bytes: &[u8]| -> [f64; N] {
                std::array::from_fn(|k| {
                    if k < width { (component.read(&bytes[k * size..]) / scale).max(lowest) } else { fill }
                })
            };
        self.read(index, accessor, width * size, read, [0.0; N])
    }

    /// Vertex indices.
    pub(super) fn indices(&self, index: usize) -> Result<Vec<u32>, ImportError> {
        let accessor = self.accessor(index)?;
        let (component, width) = self.layout(index, accessor)?;
        if width != 1 || !matches!(component, Component::U8 | Component::U16 | Component::U32) {
            return Err(damaged(self.place(index), "is used for indices, but has no unsigned scalars"));
        }
        self.read(index, accessor, component.size(), |bytes| component.read(bytes) as u32, 0)
    }

    fn place(&self, accessor: usize) -> String {
        format!("{}: accessor {accessor}", self.name)
    }

    fn layout(&self, index: usize, accessor: &Accessor) -> Result<(Component, usize), ImportError> {
        let component = Component::from_code(accessor.component_type);
        match (component, components(&accessor.shape)) {
            (Some(component), Some(width)) => Ok((component, width)),
            _ => {
                let what = format!("has elements of {} x {}", accessor.shape, accessor.component_type);
                Err(damaged(self.place(index), what))
            }
        }
    }

    fn read<T: Copy>(
        &self,
        index: usize,
        accessor: &Accessor,
        size: usize,
        read: impl Fn(&[u8]) -> T,
        zero: T,
    ) -> Result<Vec<T>, ImportError> {
        let place = self.place(index);
        let mut list = match accessor.buffer_view {
            Some(view) => {
                let elements = self.elements(&place, (view, accessor.byte_offset), accessor.count, size)?;
                elements.bytes.chunks(elements.stride).map(|element| read(&element[..size])).collect()
            }
            None if accessor.count <= MAX_ZERO_COUNT => vec![zero; accessor.count as usize],
            None => {
                let what = format!("has {} elements without any bytes", accessor.count);
                return Err(refused(Refusal::TooLarge, place, what, "export the model again"));
            }
        };
        let Some(sparse) = &accessor.sparse else { return Ok(list) };
        let kind = Component::from_code(sparse.indices.component_type);
        let Some(kind @ (Component::U8 | Component::U16 | Component::U32)) = kind else {
            return Err(damaged(place, "has sparse indices of a wrong type"));
        };
        let at = (sparse.indices.buffer_view, sparse.indices.byte_offset);
        let indices = self.elements(&place, at, sparse.count, kind.size())?;
        let values =
            self.elements(&place, (sparse.values.buffer_view, sparse.values.byte_offset), sparse.count, size)?;
        for (at, value) in indices.bytes.chunks(indices.stride).zip(values.bytes.chunks(values.stride)) {
            let at = kind.read(at) as usize;
            match list.get_mut(at) {
                Some(element) => *element = read(&value[..size]),
                None => return Err(damaged(place, format!("has a sparse value for element {at} of {}", list.len()))),
            }
        }
        Ok(list)
    }

    /// `count` elements of `size` bytes in a buffer view, from an offset on. As many chunks of the stride, of which the
    /// last may be shorter.
    fn elements(
        &self,
        place: &str,
        (view, offset): (usize, u64),
        count: u64,
        size: usize,
    ) -> Result<Elements<'a>, ImportError> {
        let Some(view_at) = self.document.buffer_views.get(view) else {
            let views = self.document.buffer_views.len();
            return Err(damaged(place, format!("refers to buffer view {view}, but there are only {views}")));
        };
        if view_at.extensions.meshopt.is_some() {
            return Err(super::compressed(self.name, "EXT_meshopt_compression"));
        }
        let buffer = self.buffers.get(view_at.buffer)?;
        let end = view_at.byte_offset.checked_add(view_at.byte_length).filter(|&end| end <= buffer.len() as u64);
        let Some(end) = end else {
            let what = format!("buffer view {view} goes beyond the {} bytes of its buffer", buffer.len());
            return Err(damaged(place, what));
        };
        let view_bytes = &buffer[view_at.byte_offset as usize..end as usize];
        let stride = if view_at.byte_stride == 0 { size as u64 } else { view_at.byte_stride };
        if stride < size as u64 {
            return Err(damaged(place, format!("elements of {size} bytes overlap: the stride is {stride}")));
        }
        if count == 0 {
            return Ok(Elements { bytes: &[], stride: stride as usize });
        }
        let length = (count - 1).checked_mul(stride).and_then(|l| l.checked_add(size as u64));
        let end = length.and_then(|l| l.checked_add(offset)).filter(|&end| end <= view_bytes.len() as u64);
        let Some(end) = end else {
            let what = format!("needs {count} elements of {size} bytes, more than buffer view {view} has");
            return Err(damaged(place, what));
        };
        Ok(Elements { bytes: &view_bytes[offset as usize..end as usize], stride: stride as usize })
    }
}
