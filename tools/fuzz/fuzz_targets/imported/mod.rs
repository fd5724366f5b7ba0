//! What every importer promises of whatever it accepts.

use pb_bake::import::{Format, load_bytes};
use pb_mesh::repair::{RepairOptions, repair};

/// Reads arbitrary bytes; what is accepted must be a sound soup, and its repair a sound mesh.
pub fn import(format: Format, data: &[u8]) {
    let Ok((model, _)) = load_bytes(format, data, None) else { return };
    let (materials, images) = (model.materials.len(), model.images.len());
    let textures = || model.materials.iter().flat_map(|m| m.textures.iter().flatten());
    assert!(textures().all(|t| (t.image as usize) < images && (t.uv_set as usize) < model.soup.uv_sets.len()));
    assert!(model.soup.material_of.iter().all(|&m| (m as usize) < materials));
    let soup = model.soup;
    let count = soup.positions.len();
    assert!(!soup.triangles.is_empty());
    assert!(soup.triangles.as_flattened().iter().all(|&i| (i as usize) < count));
    assert!(soup.normals.is_empty() || soup.normals.len() == count);
    assert!(soup.colors.is_empty() || soup.colors.len() == count);
    let Ok((mesh, report)) = repair(soup, &RepairOptions::default()) else { return };
    assert_eq!(
        report.triangles_in,
        mesh.triangles.len() as u64 + report.degenerate_removed + report.duplicates_removed
    );
    assert!(mesh.wedges.is_sorted_by_key(|w| w.position));
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corner_positions(t);
        assert!(a != b && b != c && c != a);
    }
    for wedge in &mesh.wedges {
        let length: f32 = wedge.normal.iter().map(|x| x * x).sum();
        assert!((length - 1.0).abs() < 1e-3, "{wedge:?}");
        assert!((wedge.position as usize) < mesh.positions.len());
    }
}
