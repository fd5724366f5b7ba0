//! Whole-program tests of pb-view.

mod cracks;
mod exports;
mod headless;
mod instances;
mod mistakes;
mod pops;
mod reference;
mod reports;
mod streaming;
mod support;
mod textured;
