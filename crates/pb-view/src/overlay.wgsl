// A line of text over the picture: a bitmap of one byte per pixel, drawn with a shadow box behind it.

// Lower left and size of the box in clip space.
@group(0) @binding(0) var<uniform> box: vec4<f32>;
@group(0) @binding(1) var text: texture_2d<f32>;

struct Corner {
    @builtin(position) clip: vec4<f32>,
    @location(0) uv: vec2<f32>,
}

@vertex
fn vs_box(@builtin(vertex_index) i: u32) -> Corner {
    let uv = vec2<f32>(f32(i & 1u), f32(i >> 1u));
    return Corner(vec4<f32>(box.xy + uv * box.zw, 0.0, 1.0), vec2<f32>(uv.x, 1.0 - uv.y));
}

@fragment
fn fs_text(c: Corner) -> @location(0) vec4<f32> {
    let size = vec2<f32>(textureDimensions(text));
    let ink = textureLoad(text, vec2<i32>(c.uv * size), 0).r;
    return vec4<f32>(vec3<f32>(ink), max(ink, 0.5));
}
