//! Headless flights from outside.

use crate::support::{adapter, folder, pb_view, torus};

#[test]
fn the_default_flight_draws_frames_and_statistics() {
    let Some(_) = adapter("the default flight") else { return };
    let out = folder("default_flight");
    let stats = out.join("stats.csv");
    let run = pb_view(&[
        torus().as_os_str(),
        "--headless".as_ref(),
        "--size".as_ref(),
        "320x180".as_ref(),
        "--stats".as_ref(),
        stats.as_os_str(),
        "--frames".as_ref(),
        out.as_os_str(),
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let csv = std::fs::read_to_string(stats).unwrap();
    assert!(csv.starts_with("frame,t_secs,frame_ms,triangles,draws,vram_bytes,ram_bytes,missing_chunks,error_px"));
    assert_eq!(csv.lines().count(), 302);
}
