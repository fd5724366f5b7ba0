// The surface of a model without textures: the vertices' colours. Needs surface.wgsl before it.

fn surface_of(f: Fragment) -> Surface {
    var s = matt(f);
    if view.has_colors != 0u {
        s.albedo = srgb_to_linear(clamp(f.color.rgb, vec3<f32>(0.0), vec3<f32>(1.0)));
    }
    return s;
}
