//! pb-bake.

fn main() {}
