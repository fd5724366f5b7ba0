// Light and colour of a fragment. Needs display.wgsl and clusters.wgsl before it.

fn srgb_to_linear(c: vec3<f32>) -> vec3<f32> {
    return select(pow((c + 0.055) / 1.055, vec3<f32>(2.4)), c / 12.92, c <= vec3<f32>(0.04045));
}

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

// True where the rasteriser sees a back face and the normal points away by more than `slack` (a cosine). The
// rasteriser alone is no judge: when it snaps vertices to its subpixel grid it turns slivers over, which would blink,
// and along a contour the depths of both sides are equal.
fn from_behind(f: Fragment, front: bool, slack: f32) -> bool {
    return !front && dot(normalize(f.normal), normalize(-f.position)) < -slack;
}

// Sky above, ground below, a sun and a weak light at the eye; surfaces have two sides.
fn lit(f: Fragment, front: bool, albedo: vec3<f32>) -> vec4<f32> {
    let n = normalize(f.normal) * select(1.0, -1.0, from_behind(f, front, 0.0));
    let to_eye = normalize(-f.position);
    let sky = mix(vec3<f32>(0.14, 0.13, 0.12), vec3<f32>(0.27, 0.28, 0.31), dot(n, view.sun) * 0.5 + 0.5);
    let sun = max(dot(n, view.sun), 0.0) * vec3<f32>(0.52, 0.51, 0.49);
    let head = max(dot(n, to_eye), 0.0) * 0.19;
    return vec4<f32>(albedo * (sky + sun + head), 1.0);
}

fn shaded(f: Fragment, front: bool, triangle: u32) -> vec4<f32> {
    if view.show_back_faces != 0u && from_behind(f, front, 0.25) {
        return vec4<f32>(1.0, 0.0, 1.0, 1.0);
    }
    var albedo = vec3<f32>(0.58, 0.56, 0.53);
    if view.has_colors != 0u {
        albedo = srgb_to_linear(clamp(f.color.rgb, vec3<f32>(0.0), vec3<f32>(1.0)));
    }
    switch view.color_mode {
        case 1u: { albedo = color_of_level(f.draw & 15u); }
        case 2u: { albedo = color_of(f.draw >> 4u); }
        case 3u: { albedo = color_of(triangle ^ (f.draw * 2654435761u)); }
        default: {}
    }
    return lit(f, front, albedo);
}
