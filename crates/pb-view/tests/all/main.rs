//! Whole-program tests of pb-view.

mod headless;
mod support;
