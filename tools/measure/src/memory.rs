//! What a command holds in memory at most: anonymous memory, which the system cannot take back as it can pages of files.

use anyhow::{Context, Result, bail, ensure};
use serde_json::{Value, json};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Between two looks at the command.
const PERIOD: Duration = Duration::from_millis(2);

#[derive(clap::Args)]
pub struct Arguments {
    /// Also say what that is per texel of so many.
    #[arg(long)]
    texels: Option<f64>,
    /// Most bytes per texel.
    #[arg(long, requires = "texels")]
    limit: Option<f64>,
    /// The command and its arguments.
    #[arg(required = true, trailing_var_arg = true, allow_hyphen_values = true)]
    command: Vec<String>,
}

/// What was found.
pub struct Found {
    pub figures: Value,
    /// Whether it is within the limit.
    pub holds: bool,
}

/// Runs the command to its end; it must succeed. Its output goes where errors go.
pub fn run(arguments: &Arguments) -> Result<Found> {
    let name = &arguments.command[0];
    let mut command = Command::new(name);
    command.args(&arguments.command[1..]).stdin(Stdio::null()).stdout(std::io::stderr());
    let start = Instant::now();
    let mut child = command.spawn().with_context(|| format!("{name}: does not start"))?;
    let (peak, looks) = watch(&mut child)?;
    ensure!(looks > 0, "{name}: ended before its memory was looked at, or this system has no /proc");
    let per_texel = arguments.texels.map(|texels| peak as f64 / texels);
    let figures = json!({
        "seconds": start.elapsed().as_secs_f64(), "looks": looks,
        "peak_anonymous_bytes": peak, "bytes_per_texel": per_texel,
    });
    Ok(Found { figures, holds: per_texel.zip(arguments.limit).is_none_or(|(found, most)| found <= most) })
}

/// The largest anonymous memory of a process until its end, bytes, and how often it was looked at.
fn watch(child: &mut Child) -> Result<(u64, u64)> {
    let status = format!("/proc/{}/status", child.id());
    let (mut peak, mut looks) = (0, 0);
    loop {
        if let Some(bytes) = std::fs::read_to_string(&status).ok().as_deref().and_then(anonymous) {
            (peak, looks) = (bytes.max(peak), looks + 1);
        }
        match child.try_wait()? {
            None => std::thread::sleep(PERIOD),
            Some(status) if status.success() => return Ok((peak, looks)),
            Some(status) => bail!("the command failed: {status}"),
        }
    }
}

/// Anonymous and swapped-out memory by a status file of the system, bytes.
fn anonymous(status: &str) -> Option<u64> {
    let field = |name: &str| {
        let line = status.lines().find_map(|l| l.strip_prefix(name))?;
        line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()
    };
    Some((field("RssAnon:")? + field("VmSwap:").unwrap_or(0)) * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(command: &[&str], limit: f64) -> Result<Found> {
        let command = command.iter().map(|s| s.to_string()).collect();
        run(&Arguments { texels: Some(1048576.0), limit: Some(limit), command })
    }

    #[test]
    fn swapped_memory_counts_and_files_do_not() {
        assert_eq!(anonymous("Name:\tx\nRssAnon:\t   8 kB\nRssFile:\t 999 kB\nVmSwap:\t 2 kB\n"), Some(10 << 10));
        assert_eq!(anonymous("VmSwap:\t 2 kB\n"), None);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn what_a_shell_holds_is_seen_and_compared() {
        let holding = ["sh", "-c", "x=$(head -c 33554432 /dev/zero | tr '\\0' a); sleep 0.1; test ${#x} = 33554432"];
        let found = measured(&holding, 20.0).unwrap();
        assert!(!found.holds && found.figures["bytes_per_texel"].as_f64().unwrap() > 30.0, "{}", found.figures);
        assert!(measured(&["sleep", "0.1"], 20.0).unwrap().holds);
        assert!(measured(&["false"], 20.0).is_err() && measured(&["/no/such/program"], 20.0).is_err());
    }
}
