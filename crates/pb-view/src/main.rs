//! pb-view.

use clap::Parser;
use pb_view::simulate::SimulateArgs;
use std::process::ExitCode;

fn main() -> ExitCode {
    let words: Vec<std::ffi::OsString> = std::env::args_os().collect();
    let result = match words.get(1) {
        Some(word) if word == "simulate" => pb_view::simulate::run(&SimulateArgs::parse_from(&words[1..])),
        _ => pb_view::run(pb_view::args::Args::parse_from(words)),
    };
    if let Err(error) = &result {
        eprintln!("pb-view: {}", pb_view::failure::message(error));
    }
    ExitCode::from(pb_view::failure::exit_code(&result))
}
