//! xatlas as one safe function. The only unsafe code of the helper; it stays in this process.

#[allow(unsafe_code)]
mod c {
    unsafe extern "C" {
        pub fn pb_limit_memory(bytes: u64);
        pub fn pb_charts(
            positions: *const f32,
            vertex_count: u32,
            triangles: *const u32,
            triangle_count: u32,
            max_cost: f32,
            max_iterations: u32,
            chart_of: *mut u32,
            uv: *mut f32,
        ) -> i32;
    }
}

/// What xatlas made of a mesh: scale, orientation and quality of the charts are as they come.
pub struct RawCharts {
    /// Chart of each triangle; `u32::MAX` where xatlas left a triangle out.
    pub chart_of: Vec<u32>,
    /// Number of charts; some may have no triangle.
    pub count: u32,
    /// Corners of each triangle in its chart.
    pub uv: Vec<[[f32; 2]; 3]>,
}

/// Bounds the memory of this process, where the system can.
pub fn limit_memory(bytes: u64) {
    // SAFETY: it takes a number and hands it to the system.
    #[allow(unsafe_code)]
    unsafe {
        c::pb_limit_memory(bytes)
    }
}

/// Cuts a mesh. xatlas takes lengths below about 1e-7 and areas below 1e-7 for zero, so scale the mesh. Fails where
/// xatlas does not take the mesh.
pub fn charts(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    max_cost: f32,
    max_iterations: u32,
) -> Result<RawCharts, String> {
    let vertex_count = u32::try_from(positions.len()).map_err(|e| e.to_string())?;
    let triangle_count = u32::try_from(triangles.len()).map_err(|e| e.to_string())?;
    if triangles.iter().flatten().any(|i| *i >= vertex_count) {
        return Err("a triangle uses a vertex that is not there".into());
    }
    let mut chart_of = vec![u32::MAX; triangles.len()];
    let mut uv = vec![[[0.0; 2]; 3]; triangles.len()];
    // SAFETY: the arrays are as long as the counts say, all indices are below vertex_count, and pb_charts writes
    // triangle_count and 6 * triangle_count values at most.
    #[allow(unsafe_code)]
    let count = unsafe {
        c::pb_charts(
            positions.as_ptr().cast(),
            vertex_count,
            triangles.as_ptr().cast(),
            triangle_count,
            max_cost,
            max_iterations,
            chart_of.as_mut_ptr(),
            uv.as_mut_ptr().cast(),
        )
    };
    let count = u32::try_from(count).map_err(|_| "xatlas does not take this mesh".to_string())?;
    Ok(RawCharts { chart_of, count, uv })
}
