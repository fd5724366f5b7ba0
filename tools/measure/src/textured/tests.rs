use super::*;
use crate::mesh::Mesh;
use crate::reference::scene::{Scene, Wrap};
use crate::watertight::check;

fn make(kind: Kind, name: &str, folder: &Path) -> PathBuf {
    let out = folder.join(name);
    let arguments = Arguments {
        kind,
        out: out.clone(),
        triangles: Some(4000),
        islands: Some(6),
        texture: Some(256),
        seed: 2,
        image: ImageKind::Png,
    };
    run(&arguments).unwrap();
    out
}

#[test]
fn images_of_all_kinds_show_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let torus = Torus::new(Kind::Scan, 4000, 6, 200, 2);
    let written = |name: &str| {
        let path = folder.path().join(name);
        paint::write(&torus, &path).unwrap();
        image::open(&path).unwrap().into_rgb8()
    };
    let (png, tiff, jpeg) = (written("a.png"), written("a.tif"), written("a.jpg"));
    assert!(png == tiff && png.dimensions() == (200, 200));
    let difference = png.iter().zip(jpeg.iter()).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>();
    assert!(difference < 12.0 * png.len() as f64, "{difference}");
}

#[test]
fn the_surface_is_closed_and_has_the_triangles_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let found = check(&Mesh::read(&make(Kind::Scan, "a.obj", folder.path())).unwrap());
    assert_eq!((found.unmatched_edges, found.non_manifold_edges), (0, 0));
    assert!(found.triangles.abs_diff(4000) < 800, "{}", found.triangles);
}

#[test]
fn both_formats_hold_the_same_textured_surface() {
    let folder = tempfile::tempdir().unwrap();
    let [obj, glb] = ["a.obj", "a.glb"].map(|n| Scene::read(&make(Kind::Scan, n, folder.path())).unwrap());
    assert_eq!((obj.triangles.len(), obj.texels()), (glb.triangles.len(), glb.texels()));
    for (a, b) in obj.triangles.iter().zip(&glb.triangles) {
        for k in 0..3 {
            assert!((obj.corners(a)[k] - glb.corners(b)[k]).length() < 1e-6);
            assert!((0..2).all(|i| (a.uv[k][i] - b.uv[k][i]).abs() < 1e-6));
        }
    }
}

#[test]
fn colours_agree_where_islands_meet() {
    let torus = Torus::new(Kind::Scan, 4000, 6, 2048, 2);
    // The last texels of an island and the first ones of the next: the colours of their smooth part hardly differ.
    let at = |island: u32, share: [f64; 2]| {
        let [x, y] = torus.texel_of(island, share).map(|x| x as u32);
        torus.texel(x, y).map(i32::from)
    };
    let mut off: Vec<i32> = (0..20)
        .map(|i| {
            let y = (f64::from(i) + 0.5) / 20.0;
            let (a, b) = (at(7, [0.999, y]), at(8, [0.001, y]));
            (0..3).map(|k| (a[k] - b[k]).abs()).max().unwrap_or(0)
        })
        .collect();
    off.sort_unstable();
    assert!(off[10] < 60, "{off:?}");
}

#[test]
fn loud_islands_show_their_own_colours_only_and_the_ground_is_magenta() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::read(&make(Kind::Loud, "loud.obj", folder.path())).unwrap();
    for t in &scene.triangles {
        let uv = [0, 1].map(|k| t.uv.iter().map(|uv| f64::from(uv[k])).sum::<f64>() / 3.0);
        let [_, green, blue, _] = scene.images[0].bilinear(uv, [Wrap::Clamp; 2]);
        assert_eq!((green, blue), (1.0, 0.0));
    }
    let torus = Torus::new(Kind::Loud, 4000, 6, 256, 2);
    assert_eq!(torus.texel(0, 0), [255, 0, 255]);
}

#[test]
fn a_seed_gives_the_same_image_and_another_seed_another() {
    let row = |seed| {
        let torus = Torus::new(Kind::Islands, 4000, 6, 256, seed);
        (0..256).map(|x| torus.texel(x, 100)).collect::<Vec<_>>()
    };
    assert_eq!(row(1), row(1));
    assert_ne!(row(1), row(2));
}
