//! Independent measurements.

fn main() {}
