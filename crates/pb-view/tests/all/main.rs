//! Whole-program tests of pb-view.
