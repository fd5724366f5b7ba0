//! glTF and GLB by the crate gltf: all triangles of the default scene, base colours only; skins and morphs at rest.

use anyhow::{Context, Result, bail, ensure};
use base64::Engine;
use glam::{DMat4, DQuat, DVec3};
use gltf::accessor::{DataType, Iter};
use gltf::buffer::Data;
use gltf::material::AlphaMode;
use gltf::mesh::Mode;
use gltf::texture::WrappingMode;
use gltf::{Accessor, Gltf, Node, Primitive, Semantic};
use std::path::Path;

use super::image::Image;
use super::scene::{Blend, Material, Scene, Triangle, Wrap};

/// A base colour: how it looks, and which coordinates it is looked up with.
struct BaseColor {
    material: Material,
    uv_set: u32,
    /// Rows of the map from stored to used coordinates.
    transform: [[f32; 3]; 2],
}

/// Whether images are needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Images {
    Read,
    Skipped,
}

pub fn load(path: &Path, images: Images) -> Result<Scene> {
    let bytes = std::fs::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let Gltf { document, blob } = Gltf::from_slice_without_validation(&bytes)?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let buffers = gltf::import_buffers(&document, Some(folder), blob)?;
    let mut scene = Scene::default();
    for image in document.images().filter(|_| images == Images::Read) {
        scene.images.push(Image::or_missing(open_image(image.source(), folder, &buffers)));
    }
    let base: Vec<BaseColor> = document.materials().map(|m| base_color(&m)).collect();
    scene.materials = base.iter().map(|b| b.material.clone()).collect();
    scene.materials.push(Material::plain(None, [1.0; 4]));
    let nodes: Vec<Node> = match document.default_scene() {
        Some(s) => s.nodes().collect(),
        None => {
            let children: Vec<usize> = document.nodes().flat_map(|n| n.children().map(|c| c.index())).collect();
            document.nodes().filter(|n| !children.contains(&n.index())).collect()
        }
    };
    let mut stack: Vec<(Node, DMat4)> = nodes.into_iter().rev().map(|n| (n, DMat4::IDENTITY)).collect();
    while let Some((node, parent)) = stack.pop() {
        let world = parent * local(&node);
        for primitive in node.mesh().iter().flat_map(|m| m.primitives()) {
            add(&primitive, world, &base, &buffers, &mut scene)
                .with_context(|| format!("{}: node {}", path.display(), node.index()))?;
        }
        stack.extend(node.children().map(|c| (c, world)));
    }
    if scene.colors.iter().flatten().all(|c| *c == [1.0; 4]) {
        scene.colors.clear();
    }
    Ok(scene)
}

fn local(node: &Node) -> DMat4 {
    match node.transform() {
        gltf::scene::Transform::Matrix { matrix } => DMat4::from_cols_array_2d(&matrix.map(|c| c.map(f64::from))),
        gltf::scene::Transform::Decomposed { translation, rotation, scale } => DMat4::from_scale_rotation_translation(
            DVec3::from_array(scale.map(f64::from)),
            DQuat::from_array(rotation.map(f64::from)),
            DVec3::from_array(translation.map(f64::from)),
        ),
    }
}

fn open_image(source: gltf::image::Source, folder: &Path, buffers: &[Data]) -> Result<Image> {
    match source {
        gltf::image::Source::View { view, .. } => {
            Image::decode(&buffers[view.buffer().index()][view.offset()..view.offset() + view.length()])
        }
        gltf::image::Source::Uri { uri, .. } => match uri.strip_prefix("data:") {
            Some(data) => {
                let text = data.split_once(";base64,").context("a data URI that is not base64")?.1;
                Image::decode(&base64::engine::general_purpose::STANDARD.decode(text)?)
            }
            None => Image::open(&folder.join(unescaped(uri)?)),
        },
    }
}

/// `%20` is a blank, and so on.
fn unescaped(uri: &str) -> Result<String> {
    let (bytes, mut out, mut i) = (uri.as_bytes(), Vec::new(), 0);
    while i < bytes.len() {
        let code = (bytes[i] == b'%').then(|| uri.get(i + 1..i + 3).and_then(|h| u8::from_str_radix(h, 16).ok()));
        match code.flatten() {
            Some(byte) => {
                out.push(byte);
                i += 3;
            }
            None => {
                out.push(bytes[i]);
                i += 1;
            }
        }
    }
    Ok(String::from_utf8(out)?)
}

fn base_color(material: &gltf::Material) -> BaseColor {
    let gloss = material.pbr_specular_glossiness();
    let pbr = material.pbr_metallic_roughness();
    let (factor, info) = match &gloss {
        Some(g) => (g.diffuse_factor(), g.diffuse_texture()),
        None => (pbr.base_color_factor(), pbr.base_color_texture()),
    };
    let mut out =
        BaseColor { material: Material::plain(None, factor), uv_set: 0, transform: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] };
    match material.alpha_mode() {
        AlphaMode::Opaque => {}
        AlphaMode::Mask => out.material.cutoff = Some(material.alpha_cutoff().unwrap_or(0.5)),
        AlphaMode::Blend if material.double_sided() => out.material.blend = Some(Blend::Both),
        AlphaMode::Blend => out.material.blend = Some(Blend::Front),
    }
    let Some(info) = info else { return out };
    let (texture, sampler) = (info.texture(), info.texture().sampler());
    let wrap = |mode| match mode {
        WrappingMode::ClampToEdge => Wrap::Clamp,
        WrappingMode::MirroredRepeat => Wrap::Mirror,
        WrappingMode::Repeat => Wrap::Repeat,
    };
    out.material.image = Some(texture.source().index());
    out.material.wrap = [wrap(sampler.wrap_s()), wrap(sampler.wrap_t())];
    out.material.nearest = sampler.mag_filter() == Some(gltf::texture::MagFilter::Nearest);
    out.uv_set = info.tex_coord();
    if let Some(t) = info.texture_transform() {
        let ([x, y], (sin, cos), [u, v]) = (t.scale(), t.rotation().sin_cos(), t.offset());
        out.transform = [[cos * x, sin * y, u], [-sin * x, cos * y, v]];
        out.uv_set = t.tex_coord().unwrap_or(out.uv_set);
    }
    out
}

fn add(primitive: &Primitive, world: DMat4, base: &[BaseColor], buffers: &[Data], scene: &mut Scene) -> Result<()> {
    let Some(positions) = primitive.get(&Semantic::Positions) else { return Ok(()) };
    let positions = values(&positions, buffers)?;
    let material = primitive.material().index();
    let look = material.map(|m| &base[m]);
    let uvs = primitive.get(&Semantic::TexCoords(look.map_or(0, |b| b.uv_set)));
    let uvs = uvs.map(|a| values(&a, buffers)).transpose()?;
    let colors = primitive.get(&Semantic::Colors(0)).map(|a| Ok::<_, anyhow::Error>((values(&a, buffers)?, a)));
    let colors = colors.transpose()?.map(|(list, a)| (list, a.dimensions() == gltf::accessor::Dimensions::Vec4));
    let order: Vec<u32> = match primitive.indices() {
        Some(a) => values(&a, buffers)?.iter().map(|v| v[0] as u32).collect(),
        None => (0..positions.len() as u32).collect(),
    };
    let first = scene.positions.len() as u32;
    let at = |p: &[f64; 4]| world.transform_point3(DVec3::new(p[0], p[1], p[2]));
    scene.positions.extend(positions.iter().map(at));
    let uv_of = |i: u32| {
        let [u, v, ..] = uvs.as_ref().map_or([0.0; 4], |list| list[i as usize]).map(|x| x as f32);
        look.map_or([u, v], |b| b.transform.map(|r| r[0] * u + r[1] * v + r[2]))
    };
    let color_of = |i: u32| match &colors {
        Some((list, true)) => list[i as usize].map(|x| x as f32),
        Some((list, false)) => [0, 1, 2, 3].map(|k| if k == 3 { 1.0 } else { list[i as usize][k] as f32 }),
        None => [1.0; 4],
    };
    for mut t in triangles(primitive.mode(), &order) {
        if world.determinant() < 0.0 {
            t.swap(1, 2);
        }
        ensure!(t.iter().all(|&i| (i as usize) < positions.len()), "a vertex index is out of range");
        let material = material.unwrap_or(base.len()) as u32;
        scene.triangles.push(Triangle { corners: t.map(|i| first + i), uv: t.map(uv_of), material });
        scene.colors.push(t.map(color_of));
    }
    Ok(())
}

fn triangles(mode: Mode, order: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::Triangles => order.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        Mode::TriangleStrip => {
            let turned = |(i, t): (usize, &[u32])| if i % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] };
            order.windows(3).enumerate().map(turned).collect()
        }
        Mode::TriangleFan => order.windows(2).skip(1).map(|e| [order[0], e[0], e[1]]).collect(),
        _ => Vec::new(),
    }
}

/// All elements of an accessor as numbers, normalised where it says so.
fn values(accessor: &Accessor, buffers: &[Data]) -> Result<Vec<[f64; 4]>> {
    let n = accessor.dimensions().multiplicity().min(4);
    if accessor.sparse().is_some() {
        ensure!(accessor.data_type() == DataType::F32 && n == 3, "sparse accessors are read for f32 vectors only");
        let list = Iter::<[f32; 3]>::new(accessor.clone(), |b| Some(&buffers[b.index()]));
        return Ok(list
            .context("a damaged sparse accessor")?
            .map(|p| [p[0].into(), p[1].into(), p[2].into(), 0.0])
            .collect());
    }
    let Some(view) = accessor.view() else { return Ok(vec![[0.0; 4]; accessor.count()]) };
    let bytes = &buffers[view.buffer().index()][view.offset()..view.offset() + view.length()];
    let stride = view.stride().unwrap_or(accessor.size());
    let (width, normal) = (accessor.data_type().size(), accessor.normalized());
    let number = |b: &[u8]| -> f64 {
        let scaled = |x: f64, most: f64| if normal { (x / most).max(-1.0) } else { x };
        match accessor.data_type() {
            DataType::I8 => scaled(f64::from(b[0] as i8), 127.0),
            DataType::U8 => scaled(f64::from(b[0]), 255.0),
            DataType::I16 => scaled(f64::from(i16::from_le_bytes([b[0], b[1]])), 32767.0),
            DataType::U16 => scaled(f64::from(u16::from_le_bytes([b[0], b[1]])), 65535.0),
            DataType::U32 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            DataType::F32 => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
        }
    };
    let mut out = Vec::with_capacity(accessor.count());
    for i in 0..accessor.count() {
        let start = accessor.offset() + i * stride;
        let Some(element) = bytes.get(start..start + n * width) else { bail!("an accessor leaves its buffer") };
        out.push(std::array::from_fn(|k| if k < n { number(&element[k * width..]) } else { 0.0 }));
    }
    Ok(out)
}
