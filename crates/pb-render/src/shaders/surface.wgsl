// What is known of the surface at a fragment. surface_plain.wgsl and surface_textured.wgsl fill it.

struct Surface {
    // Linear light.
    albedo: vec3<f32>,
    alpha: f32,
    // Unit vector, world space; on the front side.
    normal: vec3<f32>,
    occlusion: f32,
    roughness: f32,
    metalness: f32,
    // Linear light.
    emissive: vec3<f32>,
    // True where roughness and metalness say something.
    glossy: bool,
    // u, v in tiles, and the side of the tile in texels; 0 where there is none.
    uv: vec2<f32>,
    side: f32,
    // Mip that the pixel's size asks for, the one that is shown, and the finest that may be.
    lod: f32,
    shown_lod: f32,
    finest_lod: f32,
}

fn srgb_to_linear(c: vec3<f32>) -> vec3<f32> {
    return select(pow((c + 0.055) / 1.055, vec3<f32>(2.4)), c / 12.92, c <= vec3<f32>(0.04045));
}

// A grey, matt surface without holes.
fn matt(f: Fragment) -> Surface {
    return Surface(vec3<f32>(0.58, 0.56, 0.53), 1.0, normalize(f.normal), 1.0, 1.0, 0.0, vec3<f32>(0.0), false,
        vec2<f32>(0.0), 0.0, 0.0, 0.0, 0.0);
}
