//! Whole-program tests of pb-view.

mod cracks;
mod headless;
mod pops;
mod reference;
mod support;
