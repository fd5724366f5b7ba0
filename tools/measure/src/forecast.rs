//! How true a bake's own forecast is: the time that it says is left, beside the time that was left.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

/// Below this share of the whole time, what is left is compared as if it were so much.
const LEAST_SHARE: f64 = 0.05;

/// Bakes and follows `--progress-json`. Errors are shares of what was left.
pub fn run(pb_bake: &PathBuf, arguments: &[String]) -> Result<Value> {
    let start = Instant::now();
    let mut command = Command::new(pb_bake);
    command.args(arguments).arg("--progress-json").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = command.spawn().with_context(|| format!("{}: does not start", pb_bake.display()))?;
    let mut said: Vec<(f64, f64)> = Vec::new();
    for line in BufReader::new(child.stderr.take().context("it was piped")?).lines() {
        let line: Value = serde_json::from_str(&line?).unwrap_or_default();
        if let Some(left) = line["remaining_seconds"].as_f64() {
            said.push((start.elapsed().as_secs_f64(), left));
        }
    }
    ensure!(child.wait()?.success(), "the bake failed");
    let whole = start.elapsed().as_secs_f64();
    let error = |&(at, left): &(f64, f64)| ((left - (whole - at)) / (whole - at).max(LEAST_SHARE * whole)).abs();
    let second_half: Vec<f64> = said.iter().filter(|s| s.0 > whole / 2.0).map(error).collect();
    ensure!(!second_half.is_empty(), "the bake was over before it said anything; take a larger mesh");
    Ok(json!({
        "seconds": whole, "forecasts": said.len(),
        "worst_error_in_second_half": second_half.iter().copied().fold(0.0, f64::max),
        "mean_error_in_second_half": second_half.iter().sum::<f64>() / second_half.len() as f64,
    }))
}
