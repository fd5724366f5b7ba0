//! PLY (Turk, "The PLY Polygon File Format", 1994): ascii, binary little and big endian.
//!
//! Own reader, see docs/decisions/001-own-ply-reader.md. Counts in the header are compared with the bytes behind it
//! before anything is allocated. Elements and properties that are not needed are skipped.

mod body;
mod header;
mod scalar;
mod seams;

use super::error::{ImportError, Refusal, damaged, refused};
use super::textures::{ImageList, Model, named_image, shown};
use super::{Input, Warnings};
use body::{Body, Faces, Polygons, Rows};
use header::Element;
use pb_mesh::material::{Material, Slot, TextureRef};
use pb_mesh::mesh::{NO_MATERIAL, Soup};
use rayon::prelude::*;
use seams::Seams;

/// Rows per parallel job.
const CHUNK: usize = 1 << 15;
/// Names under which the parts of a colour are found.
const COLORS: [&[&str]; 4] = [
    &["red", "diffuse_red", "r"],
    &["green", "diffuse_green", "g"],
    &["blue", "diffuse_blue", "b"],
    &["alpha", "diffuse_alpha", "a"],
];

/// Names under which the parts of a texture coordinate are found.
const UVS: [[&str; 2]; 4] = [["s", "t"], ["u", "v"], ["texture_u", "texture_v"], ["texcoord_u", "texcoord_v"]];

/// Reads a PLY file. Texture coordinates of faces win over those of vertices; their v runs upwards.
pub(super) fn read(input: &Input, warnings: &mut Warnings) -> Result<Model, ImportError> {
    let header = header::parse(input, warnings)?;
    let wants_uvs = input.wants_uvs || !header.textures.is_empty();
    let mut soup = Soup::default();
    let mut body = Body::new(input, &header);
    let mut faces = Vec::new();
    let mut seen_vertices = false;
    for element in &header.elements {
        body.check_room(element)?;
        match element.name.as_str() {
            "vertex" if !seen_vertices => {
                seen_vertices = true;
                read_vertices(&mut body, element, wants_uvs, &mut soup)?;
            }
            "face" => faces.push(body.faces(element, wants_uvs)?),
            "tristrips" => faces.push(body.strips(element)?),
            name => {
                if name != "edge" && element.count > 0 {
                    warnings.add(format!("the element \"{name}\" is skipped"));
                }
                body.skip(element)?;
            }
        }
    }
    if !seen_vertices {
        return Err(damaged(input.name, "there is no element \"vertex\" in its header"));
    }
    take_faces(input, faces, &mut soup, warnings)?;
    Ok(textured(input, &header.textures, soup, warnings))
}

/// Gives a soup whose materials are numbers of images these materials.
fn textured(input: &Input, names: &[String], mut soup: Soup, warnings: &mut Warnings) -> Model {
    if names.is_empty() {
        soup.material_of = Vec::new();
        return Model { soup, ..Model::default() };
    }
    soup.material_of.resize(soup.triangles.len(), 0);
    let known = |m: &u32| *m == NO_MATERIAL || (*m as usize) < names.len();
    if !soup.material_of.iter().all(known) {
        warnings.add(format!("faces refer to images beyond the {} that there are; they have none", names.len()));
        soup.material_of.iter_mut().filter(|m| !known(m)).for_each(|m| *m = NO_MATERIAL);
    }
    let folders: Vec<_> = input.base.into_iter().collect();
    let mut images = ImageList::default();
    let mut material = |name: &String| {
        let image = images.add(named_image(input.name, &folders, name));
        let mut material = Material { name: shown(name), ..Material::default() };
        material.textures[Slot::BaseColor as usize] = Some(TextureRef::plain(image));
        material
    };
    let materials = names.iter().map(&mut material).collect();
    Model { soup, materials, images: images.list, ..Model::default() }
}

fn read_vertices(body: &mut Body, element: &Element, wants_uvs: bool, soup: &mut Soup) -> Result<(), ImportError> {
    let column = |names: &[&str]| names.iter().find_map(|name| element.scalar(name));
    let all = |names: [&[&str]; 3]| Some([column(names[0])?, column(names[1])?, column(names[2])?]);
    let Some(place) = all([&["x"], &["y"], &["z"]]) else {
        return Err(damaged(body.name(), "the element \"vertex\" lacks one of the properties x, y, z"));
    };
    if element.count >= u64::from(u32::MAX) {
        let what = format!("there are {} vertices, more than 32-bit indices can name", element.count);
        return Err(refused(Refusal::TooLarge, body.name(), what, "split the model"));
    }
    let normal = all([&["nx"], &["ny"], &["nz"]]);
    let color = all([COLORS[0], COLORS[1], COLORS[2]]);
    let uv = UVS.iter().find_map(|[u, v]| Some([element.scalar(u)?, element.scalar(v)?]));
    let alpha = column(COLORS[3]);
    let rows = body.rows(element)?;
    soup.positions = rows.collect(|row| place.map(|c| rows.value(row, c)));
    if let Some(normal) = normal {
        soup.normals = rows.collect(|row| normal.map(|c| rows.value(row, c) as f32));
    }
    if let Some([u, v]) = uv.filter(|_| wants_uvs) {
        let set = rows.collect(|row| [rows.value(row, u) as f32, (1.0 - rows.value(row, v)) as f32]);
        soup.uv_sets = vec![set];
    }
    if let Some(color) = color {
        soup.colors = rows.collect(|row| {
            let [r, g, b] = color.map(|c| color_byte(&rows, row, c));
            [r, g, b, alpha.map_or(255, |c| color_byte(&rows, row, c))]
        });
    }
    Ok(())
}

/// Integers of 8 bits are taken as they are, those of 16 scaled down, floats are 0 to 1.
fn color_byte(rows: &Rows, row: usize, column: usize) -> u8 {
    let value = rows.value(row, column);
    let scaled = match rows.kind(column) {
        kind if kind.is_float() => value * 255.0,
        kind if kind.size() == 2 => value / 257.0,
        _ => value,
    };
    if scaled.is_nan() { 255 } else { scaled.round() as u8 }
}

/// Moves the faces of all elements into the soup, once the number of vertices is known.
fn take_faces(input: &Input, parts: Vec<Faces>, soup: &mut Soup, warnings: &mut Warnings) -> Result<(), ImportError> {
    let count = soup.positions.len();
    let total: usize = parts.iter().map(|f| f.triangle_bound()).sum();
    if total > input.max_triangles {
        return Err(super::too_many(input.name, input.max_triangles));
    }
    let has_uvs = |f: &Faces| matches!(f, Faces::Polygons(p) if !p.uvs.is_empty());
    let mut seams = parts.iter().any(has_uvs).then(|| Seams::new(count));
    for part in parts {
        if let Some((face, index)) = part.first_bad_index(count) {
            let what = format!("face {face} (counted from 0) refers to vertex {index}, but there are {count} vertices");
            return Err(damaged(input.name, what));
        }
        match part {
            Faces::Triangles(triangles) if soup.triangles.is_empty() => soup.triangles = triangles,
            Faces::Triangles(triangles) => soup.triangles.extend(triangles),
            Faces::Polygons(polygons) => cut_polygons(&polygons, &mut seams, soup, warnings),
        }
    }
    if let Some(seams) = seams {
        seams.put_into(soup);
    }
    Ok(())
}

/// Cuts polygons into triangles of records; `seams` knows the records where faces have texture coordinates.
fn cut_polygons(polygons: &Polygons, seams: &mut Option<Seams>, soup: &mut Soup, warnings: &mut Warnings) {
    let begins = std::iter::once(0).chain(polygons.ends.iter().copied());
    let (mut corners, mut cut, mut records) = (Vec::new(), Vec::new(), Vec::new());
    if !polygons.textures.is_empty() {
        soup.material_of.resize(soup.triangles.len(), 0);
    }
    for (number, (begin, &end)) in begins.zip(&polygons.ends).enumerate() {
        let polygon = &polygons.indices[begin..end];
        records.clear();
        match seams.as_mut().filter(|_| !polygons.uvs.is_empty()) {
            Some(seams) => records.extend(polygon.iter().zip(&polygons.uvs[begin..end]).map(|(&v, &[s, t])| {
                // v runs upwards in the file.
                seams.record(v, [s, 1.0 - t])
            })),
            None => records.extend_from_slice(polygon),
        }
        match records[..] {
            [a, b, c] => soup.triangles.push([a, b, c]),
            [] | [_] | [_, _] => warnings.add("a face with fewer than three corners is skipped"),
            _ => {
                soup.polygons_triangulated += 1;
                corners.clear();
                corners.extend(polygon.iter().map(|&i| soup.positions[i as usize]));
                cut.clear();
                pb_mesh::polygon::triangulate(&corners, &mut cut);
                soup.triangles.extend(cut.iter().map(|t| t.map(|i| records[i as usize])));
            }
        }
        if let Some(&texture) = polygons.textures.get(number) {
            soup.material_of.resize(soup.triangles.len(), texture);
        }
    }
}

/// Converts a parallel pass over rows into a list in their order.
fn collect_rows<T: Send>(count: usize, make: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    (0..count).into_par_iter().with_min_len(CHUNK).map(make).collect()
}
