// Entry point where the adapter numbers the triangles of a draw.
@fragment
fn fs_main(f: Fragment, @builtin(front_facing) front: bool, @builtin(primitive_index) triangle: u32)
    -> @location(0) vec4<f32> {
    return shaded(f, front, triangle);
}
