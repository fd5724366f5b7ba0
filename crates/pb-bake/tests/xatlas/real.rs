//! The real pb-xatlas, where it is built: `just xatlas-helper`.

use super::fake::PATIENCE;
use pb_bake::xatlas::wire::{HEADER_BYTES, Kind, message};
use pb_bake::xatlas::{Charts, Found, Helper, Options, Pool, Process, Request, check};
use std::collections::HashMap;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// Where PB_XATLAS says, or among the release programs.
pub fn helper() -> Option<Helper> {
    let built = || Some(PathBuf::from(env!("CARGO_BIN_EXE_pb-bake")).parent()?.parent()?.join("release/pb-xatlas"));
    let path = std::env::var_os("PB_XATLAS").map(PathBuf::from).or_else(built).filter(|p| p.is_file());
    if path.is_none() {
        eprintln!("SKIPPED: pb-xatlas is not built; `just xatlas-helper` builds it");
    }
    Some(Helper { path: path?, found: Found::Option })
}

/// A torus of `2 * side * side` triangles: closed, curved, no disc.
fn torus(side: u32, size: f32, middle: [f32; 3]) -> Request {
    let place = |i: u32| {
        let angle = |n: u32| n as f32 / side as f32 * std::f32::consts::TAU;
        let (a, b) = (angle(i / side), angle(i % side));
        let r = 1.0 + 0.4 * b.cos();
        let p = [r * a.cos(), r * a.sin(), 0.4 * b.sin()];
        std::array::from_fn(|k| p[k] * size + middle[k])
    };
    let at = |x: u32, y: u32| (x % side) * side + y % side;
    let quad = |i: u32| {
        let (x, y) = (i / side, i % side);
        [[at(x, y), at(x + 1, y), at(x + 1, y + 1)], [at(x, y), at(x + 1, y + 1), at(x, y + 1)]]
    };
    Request {
        time_limit_ms: 60_000,
        options: Options::default(),
        positions: (0..side * side).map(place).collect(),
        triangles: (0..side * side).flat_map(quad).collect(),
    }
}

fn cut(process: &mut Process, request: &Request) -> Charts {
    let charts = process.charts(request, PATIENCE).unwrap();
    assert_eq!(check(&request.positions, &request.triangles, &charts), Ok(()));
    charts
}

/// Edges that two triangles share and that lie in one chart.
fn inner_edges(request: &Request, charts: &Charts) -> usize {
    let mut edges: HashMap<(u32, u32), u32> = HashMap::new();
    let mut inner = 0;
    for (t, [a, b, c]) in request.triangles.iter().enumerate() {
        for (from, to) in [(*a, *b), (*b, *c), (*c, *a)] {
            inner += usize::from(edges.get(&(to, from)) == Some(&charts.chart_of[t]));
            edges.insert((from, to), charts.chart_of[t]);
        }
    }
    inner
}

#[test]
fn it_cuts_a_torus_into_a_few_good_charts() {
    let Some(helper) = helper() else { return };
    let mut process = Process::start(&helper, PATIENCE).unwrap();
    assert!(process.identity().xatlas.contains("xatlas"), "{:?}", process.identity());
    let request = torus(48, 1.0, [0.0; 3]);
    let charts = cut(&mut process, &request);
    assert!((4..400).contains(&charts.count), "{} charts", charts.count);
    let inner = inner_edges(&request, &charts);
    assert!(
        inner * 10 > request.triangles.len() * 3 / 2 * 8,
        "{inner} inner edges of {}",
        request.triangles.len() * 3 / 2
    );
}

#[test]
fn charts_do_not_depend_on_size_place_or_earlier_requests() {
    let Some(helper) = helper() else { return };
    let mut process = Process::start(&helper, PATIENCE).unwrap();
    let charts = cut(&mut process, &torus(32, 1.0, [0.0; 3]));
    for exponent in [-40, 40] {
        let factor = 2f32.powi(exponent);
        let other = cut(&mut process, &torus(32, factor, [0.0; 3]));
        assert_eq!(other.chart_of, charts.chart_of);
        assert!(other.uv.as_flattened().iter().zip(charts.uv.as_flattened()).all(|(a, b)| a[0] == b[0] * factor));
    }
    assert!(cut(&mut process, &torus(32, 1.0, [100.0, -300.0, 20.0])).count > 3);
    assert_eq!(cut(&mut process, &torus(32, 1.0, [0.0; 3])), charts);
    assert_eq!(cut(&mut Process::start(&helper, PATIENCE).unwrap(), &torus(32, 1.0, [0.0; 3])), charts);
}

#[test]
fn a_lower_bound_on_stretch_gives_more_charts() {
    let Some(helper) = helper() else { return };
    let mut process = Process::start(&helper, PATIENCE).unwrap();
    let mut request = torus(48, 1.0, [0.0; 3]);
    request.options.max_cost = 16.0;
    let counts = [1e5, 1.005, 1.0005].map(|stretch| {
        request.options.max_stretch = stretch;
        cut(&mut process, &request).count
    });
    assert!(counts[0] < counts[1] && counts[1] < counts[2], "{counts:?}");
}

#[test]
fn hard_meshes_get_charts_too() {
    let Some(helper) = helper() else { return };
    let pool = Pool::new(helper).unwrap();
    let mesh = |positions: &[[f32; 3]], triangles: &[[u32; 3]]| Request {
        time_limit_ms: 60_000,
        options: Options::default(),
        positions: positions.to_vec(),
        triangles: triangles.to_vec(),
    };
    let (o, x, y, z) = ([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    let fan: Vec<[u32; 3]> = (2..40).map(|i| [0, 1, i]).collect();
    let leaf = |i: usize| [0.5, (i as f32).cos(), (i as f32).sin()];
    let fan_positions: Vec<[f32; 3]> = [o, x].into_iter().chain((2..40).map(leaf)).collect();
    let hard = [
        ("one triangle", mesh(&[o, x, y], &[[0, 1, 2]])),
        ("no area at all", mesh(&[o, o, o, x], &[[0, 1, 2], [0, 0, 3], [0, 1, 3]])),
        ("a needle", mesh(&[o, x, [0.5, 1e-9, 0.0], y], &[[0, 1, 2], [0, 2, 3]])),
        ("both sides of a triangle", mesh(&[o, x, y], &[[0, 1, 2], [0, 2, 1]])),
        ("the same triangle thrice", mesh(&[o, x, y], &[[0, 1, 2], [0, 1, 2], [1, 2, 0]])),
        ("a tetrahedron", mesh(&[o, x, y, z], &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])),
        ("forty leaves on one edge", mesh(&fan_positions, &fan)),
        ("a dot far away", mesh(&[[1e9, 1e9, 1e9], [1e9, 1e9, 1e9], [1e9, 1e9, 1e9]], &[[0, 1, 2]])),
        ("the extremes of size", mesh(&[o, x, y, [1e14, 0.0, 0.0], [0.0, 1e14, 0.0]], &[[0, 1, 2], [0, 3, 4]])),
    ];
    for (name, request) in hard {
        let charts = pool.charts(&request, PATIENCE);
        assert!(charts.is_ok(), "{name}: {charts:?}");
    }
}

#[test]
fn it_survives_what_is_no_request() {
    let Some(helper) = helper() else { return };
    let mut huge = message(Kind::Charts, &[]);
    huge[8..HEADER_BYTES].copy_from_slice(&u64::MAX.to_le_bytes());
    let mut long = message(Kind::Charts, &[]);
    long[8..HEADER_BYTES].copy_from_slice(&60_000_000u64.to_le_bytes());
    for (bytes, code) in [(vec![], 0), (b"GET / HTTP/1.1\r\n\r\n".to_vec(), 1), (huge, 1), (long, 1), (vec![0; 7], 1)] {
        let mut command = Command::new(&helper.path);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        // It may have ended before it read all.
        let _ = child.stdin.take().unwrap().write_all(&bytes);
        let output = child.wait_with_output().unwrap();
        assert_eq!((output.status.code(), output.stdout), (Some(code), vec![]), "{:?}", output.stderr);
    }
}

#[test]
fn it_ends_itself_when_time_is_over() {
    let Some(helper) = helper() else { return };
    let mut request = torus(300, 1.0, [0.0; 3]);
    request.time_limit_ms = 1;
    let mut process = Process::start(&helper, PATIENCE).unwrap();
    let text = process.charts(&request, PATIENCE).unwrap_err().to_string();
    assert!(text.contains("exit status: 4"), "{text}");
}
