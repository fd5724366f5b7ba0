//! MTL material libraries: diffuse colours, images with their options, and the physically based extension
//! (map_Pr, map_Pm, map_Ke, norm) that many programs write.
//!
//! Specular and reflection maps are ignored, as is everything else that no metallic-roughness material has.

use super::Warnings;
use super::obj_lines::number;
use super::textures::{ImageList, named_image, shown};
use pb_mesh::material::{Material, Slot, TextureRef, Wrap};
use std::path::Path;

/// Alpha below which a texel of a material with an alpha map is a hole.
const ALPHA_CUTOFF: f32 = 0.5;

/// A material of a library.
#[derive(Clone, Debug, Default)]
pub(super) struct MtlMaterial {
    /// sRGB, 0 to 1; none beside an image, which is shown as it is.
    pub(super) diffuse: Option<[f64; 3]>,
    /// All else.
    pub(super) material: Material,
}

/// Lines of a `newmtl` block that more than one field of the material depends on.
#[derive(Default)]
struct Block {
    done: MtlMaterial,
    roughness: Option<f32>,
    metallic: Option<f32>,
    emission: Option<[f32; 3]>,
    maps: [Option<TextureRef>; MAP_COUNT],
}

/// What a line with an image is for.
#[derive(Clone, Copy)]
enum Map {
    Diffuse,
    Alpha,
    Emission,
    Normal,
    Roughness,
    Metallic,
    /// Occlusion, roughness and metalness in one.
    Packed,
    Bump,
}

const MAP_COUNT: usize = 8;

/// Keywords in lower case.
const MAPS: &[(&str, Map)] = &[
    ("map_kd", Map::Diffuse),
    ("map_d", Map::Alpha),
    ("map_opacity", Map::Alpha),
    ("map_ke", Map::Emission),
    ("norm", Map::Normal),
    ("map_kn", Map::Normal),
    ("map_pr", Map::Roughness),
    ("map_pm", Map::Metallic),
    ("map_orm", Map::Packed),
    ("map_occlusionroughnessmetallic", Map::Packed),
    ("bump", Map::Bump),
    ("map_bump", Map::Bump),
];

/// Options of an image and how many words follow: at least, at most. Of the last ones those that are no numbers belong
/// to the name.
const OPTIONS: &[(&str, usize, usize)] = &[
    ("-blendu", 1, 1),
    ("-blendv", 1, 1),
    ("-bm", 1, 1),
    ("-boost", 1, 1),
    ("-cc", 1, 1),
    ("-clamp", 1, 1),
    ("-colorspace", 1, 1),
    ("-imfchan", 1, 1),
    ("-mm", 1, 2),
    ("-o", 1, 3),
    ("-s", 1, 3),
    ("-t", 1, 3),
    ("-texres", 1, 1),
    ("-type", 1, 1),
];

/// Where a library's images are, and what there is of them.
pub(super) struct Surroundings<'a> {
    /// For messages.
    pub(super) model: &'a str,
    /// The library's folder, then the model's.
    pub(super) folders: &'a [&'a Path],
    pub(super) images: &'a mut ImageList,
    pub(super) warnings: &'a mut Warnings,
}

/// Appends the materials of a library, in its order.
pub(super) fn parse(bytes: &[u8], around: &mut Surroundings, out: &mut Vec<MtlMaterial>) {
    let mut block: Option<Block> = None;
    for line in bytes.split(|&b| b == b'\n' || b == b'\r') {
        let line = String::from_utf8_lossy(line);
        let line = line.trim();
        let (word, rest) = line.split_at(line.find(char::is_whitespace).unwrap_or(line.len()));
        let rest = rest.trim();
        if word == "newmtl" {
            out.extend(block.take().map(|b| b.finish(around)));
            let named = |name: &str| {
                let material = Material { name: name.to_owned(), ..Material::default() };
                Block { done: MtlMaterial { diffuse: None, material }, ..Block::default() }
            };
            block = (!rest.is_empty()).then(|| named(rest));
        } else if let Some(block) = &mut block {
            block.line(&word.to_ascii_lowercase(), rest, around);
        }
    }
    out.extend(block.map(|b| b.finish(around)));
}

impl Block {
    fn line(&mut self, word: &str, rest: &str, around: &mut Surroundings) {
        match word {
            "kd" => self.done.diffuse = color(rest).or(self.done.diffuse),
            "ke" => self.emission = color(rest).map(|c| c.map(linear)).or(self.emission),
            "pr" => self.roughness = factor(rest).or(self.roughness),
            "pm" => self.metallic = factor(rest).or(self.metallic),
            "d" if factor(rest).is_some_and(|d| d < 1.0) => {
                around.warnings.add("transparent materials are drawn opaque");
            }
            _ => {
                if let Some((_, map)) = MAPS.iter().find(|m| m.0 == word) {
                    self.maps[*map as usize] = image(rest, around).or(self.maps[*map as usize]);
                }
            }
        }
    }

    fn finish(self, around: &mut Surroundings) -> MtlMaterial {
        let MtlMaterial { mut diffuse, mut material } = self.done;
        let map = |map: Map| self.maps[map as usize];
        let mut warn = |what: &str| around.warnings.add(format!("material \"{}\": {what}", shown(&material.name)));
        if map(Map::Bump).is_some() && map(Map::Normal).is_none() {
            warn("a bump map is not used; a normal map would be (norm)");
        }
        let packed = map(Map::Packed);
        let rough = packed.or(map(Map::Roughness));
        match (map(Map::Metallic), rough) {
            (Some(metal), Some(rough)) if metal.image != rough.image => {
                warn("the metalness map is not used, as it is another image than the roughness map");
            }
            (Some(_), None) => warn("the metalness map is not used, as there is no roughness map"),
            _ => {}
        }
        let both = packed.or(map(Map::Metallic)).is_some_and(|m| rough.is_some_and(|r| r.image == m.image));
        // Beside an image a factor of 0 stands for "not set".
        let beside = |set: Option<f32>, missing: f32| set.filter(|&x| x > 0.0).unwrap_or(missing);
        material.roughness = if rough.is_some() { beside(self.roughness, 1.0) } else { self.roughness.unwrap_or(1.0) };
        material.metallic = if both { beside(self.metallic, 1.0) } else { self.metallic.unwrap_or(0.0) };
        let emission = self.emission.unwrap_or([0.0; 3]);
        let dark = map(Map::Emission).is_some() && emission == [0.0; 3];
        material.emissive = if dark { [1.0; 3] } else { emission };
        if let Some(alpha) = map(Map::Alpha) {
            if map(Map::Diffuse).is_some_and(|d| d.image == alpha.image) {
                material.alpha_cutoff = Some(ALPHA_CUTOFF);
            } else {
                warn("an alpha map is used only where it is the alpha of map_Kd");
            }
        }
        // Programs write 0, 0.588, 0.6 or 0.8 beside an image and mean the image as it is.
        if map(Map::Diffuse).is_some() {
            diffuse = None;
        }
        let mut put = |slot: Slot, texture| material.textures[slot as usize] = texture;
        put(Slot::BaseColor, map(Map::Diffuse));
        put(Slot::MetallicRoughness, rough);
        put(Slot::Occlusion, packed);
        put(Slot::Normal, map(Map::Normal));
        put(Slot::Emissive, map(Map::Emission));
        MtlMaterial { diffuse, material }
    }
}

/// Three values, or one for all, 0 to 1.
fn color(rest: &str) -> Option<[f64; 3]> {
    let values: Vec<f64> = rest.split_ascii_whitespace().map_while(|w| number(w.as_bytes())).take(3).collect();
    let color = match values[..] {
        [r, g, b] => [r, g, b],
        [grey] => [grey; 3],
        _ => return None,
    };
    color.iter().all(|x| x.is_finite()).then(|| color.map(|x| x.clamp(0.0, 1.0)))
}

fn factor(rest: &str) -> Option<f32> {
    let value = number(rest.split_ascii_whitespace().next()?.as_bytes())?;
    value.is_finite().then(|| value.clamp(0.0, 1.0) as f32)
}

/// From sRGB (IEC 61966-2-1).
fn linear(x: f64) -> f32 {
    (if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }) as f32
}

/// Options and name of an image.
fn image(rest: &str, around: &mut Surroundings) -> Option<TextureRef> {
    let (mut scale, mut offset, mut wrap) = ([1.0; 2], [0.0; 2], Wrap::Repeat);
    let mut rest = rest;
    while let Some((option, least, most)) = OPTIONS.iter().find(|o| first_word(rest).eq_ignore_ascii_case(o.0)) {
        let mut values = Vec::new();
        rest = after_first_word(rest);
        for k in 0..*most {
            let word = first_word(rest);
            if k >= *least && number(word.as_bytes()).is_none() {
                break;
            }
            values.push(word);
            rest = after_first_word(rest);
        }
        let at = |k: usize| values.get(k).and_then(|w| number(w.as_bytes())).filter(|x| x.is_finite());
        match *option {
            "-s" => scale = [at(0).unwrap_or(1.0), at(1).unwrap_or(1.0)],
            "-o" => offset = [at(0).unwrap_or(0.0), at(1).unwrap_or(0.0)],
            "-clamp" if values.first().is_some_and(|w| w.eq_ignore_ascii_case("on")) => wrap = Wrap::Clamp,
            _ => {}
        }
    }
    if rest.is_empty() {
        return None;
    }
    let image = around.images.add(named_image(around.model, around.folders, rest));
    // OBJ's v runs upwards, ours downwards.
    let rows = [[scale[0], 0.0, offset[0]], [0.0, scale[1], 1.0 - scale[1] - offset[1]]];
    let transform = rows.map(|row| row.map(|x| x as f32));
    Some(TextureRef { transform, wrap: [wrap; 2], ..TextureRef::plain(image) })
}

fn first_word(text: &str) -> &str {
    &text[..text.find(char::is_whitespace).unwrap_or(text.len())]
}

fn after_first_word(text: &str) -> &str {
    text[first_word(text).len()..].trim_start()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::images::ImageSource;

    fn parsed(text: &str) -> (Vec<MtlMaterial>, Vec<ImageSource>, Vec<String>) {
        let (mut images, mut warnings, mut out) = (ImageList::default(), Warnings::default(), Vec::new());
        let mut around = Surroundings { model: "a.obj", folders: &[], images: &mut images, warnings: &mut warnings };
        parse(text.as_bytes(), &mut around, &mut out);
        (out, images.list, warnings.into_list())
    }

    #[test]
    fn options_are_read_and_names_may_have_blanks() {
        let text = "newmtl a b\r\n\tmap_Kd -s 2 3 1 -o 0.5 0.25 -clamp on -mm 0 1 -bm 2 my  wood 1.png \n";
        let (materials, images, warnings) = parsed(text);
        assert_eq!(materials[0].material.name, "a b");
        let texture = materials[0].material.texture(Slot::BaseColor).unwrap();
        assert_eq!(images[0].name, "my  wood 1.png");
        assert_eq!(texture.transform, [[2.0, 0.0, 0.5], [0.0, 3.0, -2.25]]);
        assert_eq!((texture.wrap, warnings.len()), ([Wrap::Clamp; 2], 0));
    }

    #[test]
    fn the_diffuse_colour_counts_only_without_an_image() {
        let (materials, ..) = parsed("newmtl a\nmap_Kd a.png\nKd 0 0 0\nnewmtl b\nKd 0 0 0\nnewmtl c\nKd 0.5");
        let diffuse: Vec<_> = materials.iter().map(|m| m.diffuse).collect();
        assert_eq!(diffuse, [None, Some([0.0; 3]), Some([0.5; 3])]);
    }

    #[test]
    fn the_physical_extension_fills_its_slots() {
        let text = "newmtl a\nPr 0\nPm 0\nmap_Pr orm.png\nmap_Pm orm.png\nmap_Ke e.png\nKe 0 0 0\nnorm n.png\nmap_Ks s.png\n\
                    newmtl b\nPr 0.25\nPm 1\nKe 1 1 1\nmap_Kd c.png\nmap_d c.png\nmap_Bump b.png\n\
                    newmtl c\nmap_Pm m.png\nmap_d x.png\nd 0.5\n";
        let (materials, images, warnings) = parsed(text);
        let slots = |m: usize| {
            Slot::ALL.map(|s| materials[m].material.texture(s).map(|t| images[t.image as usize].name.as_str()))
        };
        assert_eq!(slots(0), [None, Some("orm.png"), Some("n.png"), None, Some("e.png")]);
        let factors = |m: usize| {
            let m = &materials[m].material;
            (m.roughness, m.metallic, m.emissive, m.alpha_cutoff)
        };
        assert_eq!(factors(0), (1.0, 1.0, [1.0; 3], None));
        assert_eq!(factors(1), (0.25, 1.0, [1.0; 3], Some(0.5)));
        assert_eq!(slots(2), [None; 5]);
        for (part, count) in [("bump", 1), ("metalness", 1), ("alpha map", 1), ("drawn opaque", 1)] {
            assert_eq!(warnings.iter().filter(|w| w.contains(part)).count(), count, "{part}: {warnings:?}");
        }
    }
}
