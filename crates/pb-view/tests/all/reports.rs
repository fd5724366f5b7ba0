//! `--report`: the page, the JSON file and the CSV file of a flight, from outside.

use crate::support::{Run, adapter, column, folder, pb_view_line, small_torus, write_flight};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Twelve frames: six from afar, a cut, six from near.
fn cut_flight(folder: &Path) -> PathBuf {
    let path = folder.join("flight.json");
    let (far, near) = ([-20.0, 30.0, 9.0], [3.4, 1.5, 2.5]);
    let keys = [(0.0, far), (0.5, far), (0.6, near), (1.1, near)].map(|(t, eye)| (t, eye, [0.5, 0.0, 0.0]));
    write_flight(&path, 10.0, [0.0, 1.0, 0.0], 50.0, &keys);
    path
}

/// Flies that and writes the report `name`.html; more words of the command line name no files.
fn report(folder: &Path, name: &str, more: &str) -> (PathBuf, Run) {
    let html = folder.join(name).with_extension("html");
    let line = format!(
        "{{}} --flypath {{}} --size 160x90 --vram 400KiB --ram 150KiB --max-triangles 3000 --report {{}} {more}"
    );
    let run = pb_view_line(&line, &[small_torus(), &cut_flight(folder), &html]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    (html, run)
}

fn json(html: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(html.with_extension("json")).unwrap()).unwrap()
}

const PLOTS: [&str; 12] = [
    "frame-time",
    "fps",
    "triangles",
    "draws",
    "vram",
    "ram",
    "detail",
    "missing",
    "bytes",
    "loads",
    "processor",
    "process",
];

#[test]
fn the_page_has_every_plot_and_needs_nothing_else() {
    let Some(_) = adapter("a report's page") else { return };
    let (html, run) = report(&folder("report_page"), "page", "");
    assert!(run.stdout.contains("page.html") && run.stdout.contains("page.json") && run.stdout.contains("page.csv"));
    let text = std::fs::read_to_string(&html).unwrap();
    let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
    let tree = roxmltree::Document::parse_with_options(&text, options).unwrap();
    let all = || tree.descendants().filter(|n| n.is_element());
    for plot in PLOTS {
        let id = format!("plot-{plot}");
        let figure = all().find(|n| n.attribute("id") == Some(&id)).unwrap_or_else(|| panic!("{id} is missing"));
        let lines = figure.descendants().filter(|n| n.has_tag_name(("http://www.w3.org/2000/svg", "polyline")));
        assert!(lines.count() > 0, "{id} has no lines");
        let bounded = figure.descendants().filter(|n| n.attribute("stroke") == Some("#C62828")).count() > 10;
        assert_eq!(bounded, ["vram", "ram", "triangles"].contains(&plot), "{id}: a bound is drawn where there is one");
    }
    for element in all() {
        assert!(!["script", "link", "iframe", "object"].contains(&element.tag_name().name()));
        for attribute in element.attributes().filter(|a| ["src", "href", "data", "action"].contains(&a.name())) {
            assert!(attribute.value().starts_with("data:image/jpeg;base64,"), "{}", attribute.value());
        }
    }
    assert!(!text.contains("url(") && !text.contains("@import"));
    let pictures = all().filter(|n| n.has_tag_name("img")).count();
    assert!((3..=12).contains(&pictures), "{pictures}: first, last and keyframes at least");
    assert!(text.contains("Full detail after a cut") && text.contains("frame 6 at 0.60 s"));
}

#[test]
fn all_files_hold_the_same_numbers() {
    let Some(_) = adapter("a report's numbers") else { return };
    let (html, _) = report(&folder("report_numbers"), "numbers", "");
    let (csv, json) = (html.with_extension("csv"), json(&html));
    assert_eq!((&json["schema"], &json["version"]), (&"pb-view-report".into(), &1.into()));
    let header = std::fs::read_to_string(&csv).unwrap().lines().next().unwrap().to_owned();
    let names: Vec<&str> = header.split(',').collect();
    assert_eq!(json["columns"].as_object().unwrap().len(), names.len());
    for name in &names {
        let values: Vec<f64> = json["columns"][name].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        assert_eq!(values, column(&csv, name), "{name}");
    }
    let mut frame_ms = column(&csv, "frame_ms");
    frame_ms.sort_by(f64::total_cmp);
    let s = &json["summary"];
    assert_eq!((s["frame_ms"]["max"].as_f64(), s["frame_ms"]["p50"].as_f64()), (Some(frame_ms[11]), Some(frame_ms[5])));
    let sum = |name: &str| column(&csv, name).iter().sum::<f64>();
    assert_eq!(s["bytes"]["disk_bytes"].as_f64(), Some(sum("disk_bytes")));
    assert_eq!(s["vram"]["peak_bytes"].as_f64(), column(&csv, "vram_bytes").into_iter().reduce(f64::max));
    assert_eq!(s["vram"]["bound_bytes"], 400 << 10);
    assert_eq!(
        s["cuts"].as_array().unwrap().iter().map(|c| c["frame"].as_u64()).collect::<Vec<_>>(),
        [Some(0), Some(6)]
    );
    assert_eq!(json["archive"]["triangles_in"], 18432);
}

#[test]
fn columns_agree_with_one_another() {
    let Some(_) = adapter("columns of a settled flight") else { return };
    let (html, _) = report(&folder("report_columns"), "settled", "--settle");
    let all = |name: &str| column(&html.with_extension("csv"), name);
    let (disk, needed) = (all("disk_bytes"), all("needed_bytes"));
    assert!(disk.iter().sum::<f64>() > 0.0 && needed.iter().sum::<f64>() <= disk.iter().sum());
    assert!(all("upload_bytes").iter().sum::<f64>() > 0.0);
    assert!(all("missing_chunks").iter().chain(&all("fading")).all(|v| *v == 0.0), "every frame is settled");
    assert!(all("wanted_chunks").iter().any(|w| *w > 0.0));
    assert!(all("prefetch_bytes").iter().zip(&disk).all(|(part, whole)| part <= whole));
    assert_eq!(json(&html)["summary"]["cuts"][1]["frames_to_full"], 0);
}

#[test]
fn an_earlier_run_is_drawn_into_the_plots() {
    let Some(_) = adapter("runs compared") else { return };
    let out = folder("report_compare");
    let (first, _) = report(&out, "before", "");
    let page = out.join("after.html");
    let line = "{} --flypath {} --size 160x90 --report {} --compare {}";
    let run = pb_view_line(line, &[small_torus(), &cut_flight(&out), &page, &first.with_extension("json")]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let text = std::fs::read_to_string(&page).unwrap();
    for plot in text.split("<figure id=\"plot-").skip(1) {
        assert!(plot.split("</figure>").next().unwrap().contains("\nbefore\n"), "{}", &plot[..20]);
    }
    assert!(text.contains("<th>after</th><th>before</th>"), "the table of numbers has a column for each");
}

#[test]
fn what_is_wrong_with_a_report_is_said_before_the_flight() {
    let out = folder("report_mistakes");
    let (flight, file, json) = (cut_flight(&out), out.join("file"), out.join("other.json"));
    std::fs::write(&file, "in the way").unwrap();
    std::fs::write(&json, "{}").unwrap();
    let (below, good) = (file.join("r.html"), out.join("good.html"));
    // Of an earlier test run.
    let _ = std::fs::remove_file(&good);
    let wrong = |line: &str, last: &[&Path], words: &str| {
        let frames = out.join("frames");
        let line = format!("{{}} --flypath {{}} {line}");
        let run = pb_view_line(&line, &[&[small_torus(), &flight], last].concat());
        assert!(run.code == 2 && run.stderr.contains(words), "{line}: {} {}", run.code, run.stderr);
        assert!(!run.stderr.contains("panicked") && run.stdout.is_empty() && !frames.exists());
    };
    wrong("--report {}", &[&below], "cannot write the report");
    wrong("--report r.png", &[], "end in .html");
    wrong("--report {} --compare {}", &[&good, &json], "JSON file of a --report");
    wrong("--report {} --compare none.json", &[&good], "none.json");
    assert!(!good.exists(), "a run that never began leaves no report");
    wrong("--compare {}", &[&json], "--report");
}
