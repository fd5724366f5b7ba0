// The surface of a textured model. Needs surface.wgsl and textures.wgsl before it.

// The frame of the tile at a fragment, from derivatives: Mikkelsen 2010, "Bump mapping unparametrized surfaces on the
// GPU", for normal maps. Columns: dP/du, -dP/dv (green up, v runs down), both at right angles to the normal, unit
// length; and the normal. Where u, v stand still: the normal alone.
fn tile_frame(n: vec3<f32>, dpx: vec3<f32>, dpy: vec3<f32>, dx: vec2<f32>, dy: vec2<f32>) -> mat3x3<f32> {
    // dP/du and dP/dv times the area, which is positive where u, v keep their orientation on the screen.
    let area = dx.x * dy.y - dx.y * dy.x;
    let sign = select(-1.0, 1.0, area >= 0.0);
    let along_u = (dpx * dy.y - dpy * dx.y) * sign;
    let along_v = (dpy * dx.x - dpx * dy.x) * sign;
    let t = along_u - n * dot(n, along_u);
    let b = along_v - n * dot(n, along_v);
    let tt = dot(t, t);
    let bb = dot(b, b);
    let there = tt > 0.0 && bb > 0.0 && area != 0.0;
    return mat3x3<f32>(select(vec3(0.0), t * inverseSqrt(tt), there), select(vec3(0.0), -b * inverseSqrt(bb), there), n);
}

fn surface_of(f: Fragment) -> Surface {
    var s = matt(f);
    let dx = dpdx(f.center_uv);
    let dy = dpdy(f.center_uv);
    let p = footprint(f.draw >> 4u, f.color.xy, dx, dy);
    s.uv = p.uv;
    s.side = f32(1u << (p.sides & 15u));
    s.lod = p.lod;
    s.shown_lod = clamp(p.lod, p.finest, p.last);
    s.finest_lod = p.finest;
    let base = map_of(BASE_COLOR);
    if base != NO_MAP {
        let color = sample_map(base_color_pages, p, base);
        s.albedo = color.rgb;
        s.alpha = color.a;
    }
    let orm = map_of(ORM);
    if orm != NO_MAP {
        let c = sample_map(orm_pages, p, orm);
        s.occlusion = c.r;
        s.roughness = c.g;
        s.metalness = c.b;
        s.glossy = true;
    }
    let normal = map_of(NORMAL);
    if normal != NO_MAP {
        let xy = sample_map(normal_pages, p, normal).rg * 2.0 - 1.0;
        let z = sqrt(max(1.0 - dot(xy, xy), 0.0));
        let frame = tile_frame(s.normal, dpdx(f.center_position), dpdy(f.center_position), dx, dy);
        s.normal = normalize(frame * vec3<f32>(xy, z));
    }
    let emissive = map_of(EMISSIVE);
    if emissive != NO_MAP {
        s.emissive = sample_map(emissive_pages, p, emissive).rgb;
    }
    return s;
}
