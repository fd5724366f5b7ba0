// Entry point where the adapter numbers the triangles of a draw.
@fragment
fn fs_main(f: Fragment, @builtin(front_facing) front: bool, @builtin(primitive_index) triangle: u32)
    -> Shown {
    return shaded(f, front, triangle);
}
