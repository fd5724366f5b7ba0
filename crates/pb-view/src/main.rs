//! pb-view.

fn main() {}
