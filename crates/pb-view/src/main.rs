//! pb-view.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let args = pb_view::args::Args::parse();
    let result = pb_view::run(args);
    if let Err(error) = &result {
        eprintln!("pb-view: {}", pb_view::failure::message(error));
    }
    ExitCode::from(pb_view::failure::exit_code(&result))
}
