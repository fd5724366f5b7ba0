//! Materials as importers hand them over: which images they use, where on them a surface point lies, and the factors
//! on top. Metallic-roughness model of glTF 2.0 (section 3.9); other models are converted by their readers.
//!
//! The base colour factor is not here: importers multiply it into the vertex colours of a [`Soup`](crate::mesh::Soup).

/// The kinds of images that a material may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Slot {
    /// sRGB colour and straight alpha; linear light where the image is HDR.
    BaseColor,
    /// Green: roughness, blue: metalness. Linear.
    MetallicRoughness,
    /// Tangent-space normal, `2 c - 1`, green up (OpenGL convention, as in glTF).
    Normal,
    /// Red: ambient occlusion. Linear.
    Occlusion,
    /// sRGB emitted light; linear light where the image is HDR.
    Emissive,
}

impl Slot {
    /// All slots, in the order of [`Material::textures`].
    pub const ALL: [Slot; 5] =
        [Slot::BaseColor, Slot::MetallicRoughness, Slot::Normal, Slot::Occlusion, Slot::Emissive];
}

/// What an image shows outside the unit square.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// Tiles.
    #[default]
    Repeat,
    /// Tiles, every second one mirrored.
    Mirror,
    /// The border texels go on for ever.
    Clamp,
}

/// An image on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureRef {
    /// Index into the scene's images.
    pub image: u32,
    /// Which set of texture coordinates of the mesh.
    pub uv_set: u32,
    /// Applied to a coordinate before the image is looked up: `u' = t[0][0] u + t[0][1] v + t[0][2]`, `v'` by row 1.
    pub transform: [[f32; 3]; 2],
    /// Per axis u, v.
    pub wrap: [Wrap; 2],
    /// No interpolation between texels when magnified.
    pub nearest: bool,
}

impl TextureRef {
    /// The first UV set, untransformed, repeated.
    pub fn plain(image: u32) -> TextureRef {
        TextureRef {
            image,
            uv_set: 0,
            transform: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            wrap: [Wrap::Repeat; 2],
            nearest: false,
        }
    }
}

/// What the surface of some triangles is made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// For messages.
    pub name: String,
    /// 0 dielectric to 1 metal; multiplied with the image.
    pub metallic: f32,
    /// 0 mirror to 1 matt; multiplied with the image.
    pub roughness: f32,
    /// Linear light, may exceed 1; multiplied with the image.
    pub emissive: [f32; 3],
    /// Multiplies x and y of the normal map.
    pub normal_scale: f32,
    /// 0: the occlusion map does nothing.
    pub occlusion_strength: f32,
    /// Texels with less alpha are holes (cut-out); `None`: opaque, alpha is ignored.
    pub alpha_cutoff: Option<f32>,
    /// What is behind shows through as alpha says, approximately (see [`texture::veil`](crate::texture::veil)); only with
    /// a cutoff.
    pub is_blended: bool,
    /// By [`Slot`], in the order of [`Slot::ALL`].
    pub textures: [Option<TextureRef>; 5],
}

impl TextureRef {
    /// Where on the image a coordinate of the mesh lies, in units of the image.
    pub fn apply(&self, [u, v]: [f32; 2]) -> [f32; 2] {
        self.transform.map(|row| row[0] * u + row[1] * v + row[2])
    }
}

impl Default for Material {
    /// White, matt, opaque, without images.
    fn default() -> Self {
        Material {
            name: String::new(),
            metallic: 0.0,
            roughness: 1.0,
            emissive: [0.0; 3],
            normal_scale: 1.0,
            occlusion_strength: 1.0,
            alpha_cutoff: None,
            is_blended: false,
            textures: [None; 5],
        }
    }
}

impl Material {
    /// The image in a slot.
    pub fn texture(&self, slot: Slot) -> Option<&TextureRef> {
        self.textures[slot as usize].as_ref()
    }
}
