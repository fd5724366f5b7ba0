// Entry point where the adapter has no primitive index: a triangle is named by one of its vertices.
@fragment
fn fs_main(f: Fragment, @builtin(front_facing) front: bool) -> Shown {
    return shaded(f, front, f.vertex);
}
