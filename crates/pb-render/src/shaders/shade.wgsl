// Light and colour of a fragment. Needs surface.wgsl and what follows it before.

// Fragments with less alpha than the first are holes; with every step another of a pixel's four samples is covered, as
// pb-mesh's texture/veil.rs stores it.
override cutouts: bool = false;
const HOLE_ALPHA = 0.5;
const VEIL_STEP = 0.06;
// Of a pixel, 1 or 4.
override samples: u32 = 4u;

struct Shown {
    @location(0) color: vec4<f32>,
    @builtin(sample_mask) samples: u32,
}

// Which samples a surface covers that alpha makes a screen door of. Its two sides cover different ones, so that of glass
// both are seen. With one sample, pixels of 2 x 2 take the samples' place.
fn covered_samples(alpha: f32, front: bool, pixel: vec2<f32>) -> u32 {
    if alpha < HOLE_ALPHA {
        return 0u;
    }
    let more = min(u32((alpha - HOLE_ALPHA) / VEIL_STEP), 3u);
    let some = (2u << more) - 1u;
    let mask = select(((some << 1u) | (some >> 3u)) & 15u, some, front);
    if samples > 1u {
        return mask;
    }
    let place = vec2<u32>(pixel) & vec2<u32>(1u);
    return (mask >> (place.x * 2u + (place.x ^ place.y))) & 1u;
}

const SHADED = 0u;
const LEVEL = 1u;
const CLUSTER = 2u;
const TRIANGLE = 3u;
const ALBEDO = 4u;
const NORMALS = 5u;
const MIPS = 6u;
const TEXELS = 7u;
const CHECKER = 8u;

const SUN = vec3<f32>(0.52, 0.51, 0.49);
const GROUND = vec3<f32>(0.14, 0.13, 0.12);
const SKY = vec3<f32>(0.27, 0.28, 0.31);
// A weak light at the eye.
const HEAD = 0.19;

// A lively colour for a number; neighbouring numbers look unlike each other. Linear light.
fn color_of(number: u32) -> vec3<f32> {
    var h = number * 747796405u + 2891336453u;
    h = ((h >> ((h >> 28u) + 4u)) ^ h) * 277803737u;
    h = (h >> 22u) ^ h;
    let hue = f32(h & 0xffffu) / 65536.0 * 6.0;
    let rgb = clamp(vec3<f32>(abs(hue - 3.0) - 1.0, 2.0 - abs(hue - 2.0), 2.0 - abs(hue - 4.0)), vec3(0.0), vec3(1.0));
    return mix(vec3<f32>(0.75), rgb, 0.35 + 0.4 * f32((h >> 16u) & 0xffu) / 255.0);
}

// Fine to coarse: green, yellow, orange, red, purple, blue, then again.
fn color_of_level(level: u32) -> vec3<f32> {
    var palette = array<vec3<f32>, 6>(
        vec3(0.15, 0.65, 0.2), vec3(0.85, 0.75, 0.1), vec3(0.9, 0.4, 0.08),
        vec3(0.75, 0.08, 0.1), vec3(0.45, 0.12, 0.6), vec3(0.1, 0.25, 0.8),
    );
    return palette[level % 6u];
}

// The palette between whole levels.
fn color_of_lod(lod: f32) -> vec3<f32> {
    let level = floor(max(lod, 0.0));
    return mix(color_of_level(u32(level)), color_of_level(u32(level) + 1u), max(lod, 0.0) - level);
}

// Texels per pixel along the shorter axis, as log2: blue where there are too few, green at one, red where there are
// far more than the pixels can show.
fn color_of_density(density: f32) -> vec3<f32> {
    let few = mix(vec3(0.1, 0.6, 0.15), vec3(0.05, 0.1, 0.8), clamp(-density / 3.0, 0.0, 1.0));
    let many = mix(vec3(0.1, 0.6, 0.15), vec3(0.8, 0.08, 0.05), clamp((density - 1.0) / 3.0, 0.0, 1.0));
    return select(many, few, density < 0.0);
}

// Squares of 8 texels and of an eighth of the tile, in a hue of u and v; fine ones fade where pixels are larger.
fn checker(s: Surface) -> vec3<f32> {
    let fine = floor(s.uv * s.side / 8.0);
    let coarse = floor(s.uv * 8.0);
    let fine_sign = select(-1.0, 1.0, (u32(fine.x) + u32(fine.y)) % 2u == 0u) * clamp(3.0 - s.lod, 0.0, 1.0);
    let coarse_sign = select(-1.0, 1.0, (u32(coarse.x) + u32(coarse.y)) % 2u == 0u);
    let hue = vec3<f32>(0.25 + 0.6 * s.uv.x, 0.25 + 0.6 * s.uv.y, 0.45);
    return hue * (0.7 + 0.2 * coarse_sign + 0.1 * fine_sign);
}

// True where the rasteriser sees a back face and the normal points away by more than `slack` (a cosine). The
// rasteriser alone is no judge: when it snaps vertices to its subpixel grid it turns slivers over, which would blink,
// and along a contour the depths of both sides are equal.
fn from_behind(f: Fragment, front: bool, slack: f32) -> bool {
    return !front && dot(normalize(f.normal), normalize(-f.position)) < -slack;
}

fn sky(direction: vec3<f32>) -> vec3<f32> {
    return mix(GROUND, SKY, dot(direction, view.sun) * 0.5 + 0.5);
}

// Sky above, ground below, a sun and a weak light at the eye; matt.
fn lit_matt(n: vec3<f32>, to_eye: vec3<f32>, albedo: vec3<f32>, occlusion: f32) -> vec3<f32> {
    let sun = max(dot(n, view.sun), 0.0) * SUN;
    let head = max(dot(n, to_eye), 0.0) * HEAD;
    return albedo * (sky(n) * occlusion + sun + head);
}

// Microfacets with the GGX distribution (Walter et al. 2007) and the height-correlated Smith term as approximated by
// Hammon 2017; times pi, because lights are given as what a white matt surface returns.
fn ggx(n: vec3<f32>, v: vec3<f32>, l: vec3<f32>, f0: vec3<f32>, roughness: f32) -> vec3<f32> {
    let h = normalize(v + l);
    // Cosines may come out a little above 1.
    let nl = saturate(dot(n, l));
    let nv = clamp(dot(n, v), 1e-3, 1.0);
    let nh = saturate(dot(n, h));
    let a = roughness * roughness;
    let d = nh * nh * (a * a - 1.0) + 1.0;
    let smith = 0.5 / max(mix(2.0 * nl * nv, nl + nv, a), 1e-4);
    let fresnel = f0 + (1.0 - f0) * pow(1.0 - saturate(dot(v, h)), 5.0);
    return fresnel * (a * a / (d * d)) * smith * nl;
}

// What a glossy surface returns of an even sky: Karis 2014, "Physically based shading on mobile".
fn even_sky(f0: vec3<f32>, roughness: f32, nv: f32) -> vec3<f32> {
    let r = roughness * vec4<f32>(-1.0, -0.0275, -0.572, 0.022) + vec4<f32>(1.0, 0.0425, 1.04, -0.04);
    let a = min(r.x * r.x, exp2(-9.28 * nv)) * r.x + r.y;
    return f0 * (-1.04 * a + r.z) + (1.04 * a + r.w);
}

// Metallic-roughness shading (glTF 2.0, appendix B).
fn lit_glossy(s: Surface, n: vec3<f32>, to_eye: vec3<f32>) -> vec3<f32> {
    let roughness = clamp(s.roughness, 0.05, 1.0);
    let f0 = mix(vec3<f32>(0.04), s.albedo, s.metalness);
    let matt = lit_matt(n, to_eye, s.albedo * (1.0 - s.metalness), s.occlusion);
    let mirrored = sky(reflect(-to_eye, n)) * even_sky(f0, roughness, max(dot(n, to_eye), 0.0)) * s.occlusion;
    let shine = ggx(n, to_eye, view.sun, f0, roughness) * SUN + ggx(n, to_eye, to_eye, f0, roughness) * HEAD;
    return matt + mirrored + shine;
}

// Light up to 0.8 as it is; more is bent so that it stays below 1, in its hue.
fn tone_mapped(light: vec3<f32>) -> vec3<f32> {
    let most = max(light.r, max(light.g, light.b));
    if view.tone_map == 0u || most <= 0.8 {
        return light;
    }
    return light * ((0.8 + 0.2 * (1.0 - exp((0.8 - most) / 0.2))) / most);
}

// The surface in light; surfaces have two sides.
fn lit(f: Fragment, front: bool, s: Surface) -> vec3<f32> {
    let n = s.normal * select(1.0, -1.0, from_behind(f, front, 0.0));
    let to_eye = normalize(-f.position);
    if !s.glossy {
        return lit_matt(n, to_eye, s.albedo, s.occlusion) + s.emissive;
    }
    return lit_glossy(s, n, to_eye) + s.emissive;
}

// The surface as the colour mode shows it: false colours are matt, over the texture's brightness where there is one.
fn in_false_color(s: Surface, color: vec3<f32>, over_texture: bool) -> Surface {
    var out = s;
    let light = dot(s.albedo, vec3<f32>(0.2126, 0.7152, 0.0722));
    out.albedo = color * select(1.0, 0.4 + light, s.side > 0.0 && over_texture);
    out.glossy = false;
    out.emissive = vec3<f32>(0.0);
    return out;
}

fn shaded(f: Fragment, front: bool, triangle: u32) -> Shown {
    let s = surface_of(f);
    var mask = 15u;
    if cutouts {
        mask = covered_samples(s.alpha, front, f.clip.xy);
        if mask == 0u {
            discard;
        }
    }
    return Shown(color_shown(f, front, triangle, s), mask);
}

fn color_shown(f: Fragment, front: bool, triangle: u32, surface: Surface) -> vec4<f32> {
    var s = surface;
    if view.show_back_faces != 0u && from_behind(f, front, 0.25) {
        return vec4<f32>(1.0, 0.0, 1.0, 1.0);
    }
    switch view.color_mode {
        case LEVEL: { s = in_false_color(s, color_of_level(f.draw & 15u), true); }
        case CLUSTER: { s = in_false_color(s, color_of(f.draw >> 4u), false); }
        case TRIANGLE: { s = in_false_color(s, color_of(triangle ^ (f.draw * 2654435761u)), false); }
        case ALBEDO: { return vec4<f32>(s.albedo, 1.0); }
        case NORMALS: { return vec4<f32>(srgb_to_linear(s.normal * 0.5 + 0.5), 1.0); }
        case MIPS: { s = in_false_color(s, color_of_lod(s.shown_lod), true); }
        case TEXELS: { s = in_false_color(s, color_of_density(s.lod - s.finest_lod), true); }
        case CHECKER: { s = in_false_color(s, checker(s), false); }
        default: {}
    }
    let light = lit(f, front, s);
    return vec4<f32>(select(light, tone_mapped(light), s.side > 0.0), 1.0);
}
