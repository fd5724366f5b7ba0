//! The node tree of a glTF document: which mesh is drawn where, in world space. Without recursion: files are outside
//! data, and chains may be long.

use super::super::error::{ImportError, Refusal, damaged, refused};
use super::accessor::Reader;
use super::document::{InstanceAttributes, Node};
use glam::{DMat4, DQuat, DVec3};

/// A mesh at a place.
pub(super) struct Placed {
    pub(super) mesh: usize,
    /// Object to world.
    pub(super) world: DMat4,
}

/// All meshes of the default scene, or of all root nodes where there is no default; instances expanded, at most
/// `max_count`.
pub(super) fn placed_meshes(reader: &Reader, max_count: usize) -> Result<Vec<Placed>, ImportError> {
    let nodes = &reader.document.nodes;
    let mut reached = vec![false; nodes.len()];
    let mut stack: Vec<(usize, DMat4)> = roots(reader)?.iter().rev().map(|&n| (n, DMat4::IDENTITY)).collect();
    let mut placed = Vec::new();
    while let Some((index, parent)) = stack.pop() {
        let place = || format!("{}: node {index}", reader.name);
        let Some(node) = nodes.get(index) else {
            return Err(damaged(place(), format!("is referred to, but there are only {} nodes", nodes.len())));
        };
        if std::mem::replace(&mut reached[index], true) {
            return Err(damaged(place(), "is reached in two ways: the nodes form a loop, or it has several parents"));
        }
        let world = parent * local_transform(node);
        if let Some(mesh) = node.mesh {
            let before = placed.len();
            match &node.extensions.instancing {
                None => placed.push(Placed { mesh, world }),
                Some(instancing) => add_instances(reader, &instancing.attributes, (index, mesh, world), &mut placed)?,
            }
            if let Some(at) = placed[before..].iter().position(|at| !at.world.is_finite()) {
                let place = match &node.extensions.instancing {
                    None => place(),
                    Some(_) => format!("{}, instance {at}", place()),
                };
                let what = "its place is not made of finite numbers";
                return Err(refused(Refusal::NotFinite, place, what, "remove it or export the model again"));
            }
        }
        if placed.len() > max_count {
            return Err(super::super::too_many(reader.name, max_count));
        }
        stack.extend(node.children.iter().rev().map(|&child| (child, world)));
    }
    Ok(placed)
}

fn roots(reader: &Reader) -> Result<Vec<usize>, ImportError> {
    let document = reader.document;
    if let Some(index) = document.scene {
        let scene = document.scenes.get(index).ok_or_else(|| {
            let what = format!("the default scene is {index}, but there are only {} scenes", document.scenes.len());
            damaged(reader.name, what)
        })?;
        return Ok(scene.nodes.clone());
    }
    let mut is_child = vec![false; document.nodes.len()];
    for &child in document.nodes.iter().flat_map(|n| &n.children) {
        if let Some(flag) = is_child.get_mut(child) {
            *flag = true;
        }
    }
    let roots: Vec<usize> = (0..is_child.len()).filter(|&n| !is_child[n]).collect();
    if roots.is_empty() && !is_child.is_empty() {
        return Err(damaged(reader.name, "no node is a root: the nodes form a loop"));
    }
    Ok(roots)
}

fn local_transform(node: &Node) -> DMat4 {
    match node.matrix {
        Some(matrix) => DMat4::from_cols_array(&matrix),
        None => transform(node.translation, node.rotation, node.scale),
    }
}

fn transform(translation: Option<[f64; 3]>, rotation: Option<[f64; 4]>, scale: Option<[f64; 3]>) -> DMat4 {
    let rotation = DQuat::from_array(rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]));
    let length = rotation.length();
    // Without a length it turns nothing; what is no number stays none, and is refused with its node.
    let rotation = if length == 0.0 { DQuat::IDENTITY } else { rotation / length };
    DMat4::from_scale_rotation_translation(
        DVec3::from_array(scale.unwrap_or([1.0; 3])),
        rotation,
        DVec3::from_array(translation.unwrap_or([0.0; 3])),
    )
}

/// EXT_mesh_gpu_instancing: one copy per element of its attributes.
fn add_instances(
    reader: &Reader,
    attributes: &InstanceAttributes,
    (node, mesh, world): (usize, usize, DMat4),
    placed: &mut Vec<Placed>,
) -> Result<(), ImportError> {
    let translations = attributes.translation.map(|a| reader.vectors::<3>(a, 3, 0.0)).transpose()?;
    let rotations = attributes.rotation.map(|a| reader.vectors::<4>(a, 4, 0.0)).transpose()?;
    let scales = attributes.scale.map(|a| reader.vectors::<3>(a, 3, 1.0)).transpose()?;
    let counts = [translations.as_ref().map(Vec::len), rotations.as_ref().map(Vec::len), scales.as_ref().map(Vec::len)];
    let count = counts.iter().flatten().copied().max().unwrap_or(0);
    if counts.iter().flatten().any(|&n| n != count) {
        let counts: Vec<String> = counts.iter().flatten().map(usize::to_string).collect();
        let what = format!("the attributes of EXT_mesh_gpu_instancing have different counts: {}", counts.join(", "));
        return Err(damaged(format!("{}: node {node}", reader.name), what));
    }
    placed.extend((0..count).map(|i| {
        let at = |list: &Option<Vec<[f64; 3]>>| list.as_ref().map(|l| l[i]);
        let local = transform(at(&translations), rotations.as_ref().map(|r| r[i]), at(&scales));
        Placed { mesh, world: world * local }
    }));
    Ok(())
}
