// The surface of a textured model. Needs surface.wgsl and textures.wgsl before it.

// Normal maps hold x, y, z of the model instead of x, y in the tile's frame.
override object_normals: bool = false;
// Mixtures of normals that are shorter have no direction.
const SHORTEST = 0.05;

// The frame of the tile at a fragment, as pb-mesh's texture/normal.rs defines it, from derivatives (Mikkelsen 2010,
// "Bump mapping unparametrized surfaces on the GPU"): along dP/du at right angles to the normal; at right angles to both,
// on the side away from dP/dv (green up, v runs down); the normal. Where u, v stand still: the normal alone.
fn tile_frame(n: vec3<f32>, dpx: vec3<f32>, dpy: vec3<f32>, dx: vec2<f32>, dy: vec2<f32>) -> mat3x3<f32> {
    let area = dx.x * dy.y - dx.y * dy.x;
    let sign = select(-1.0, 1.0, area >= 0.0);
    // dP/du and dP/dv times the area's size.
    let along_u = (dpx * dy.y - dpy * dx.y) * sign;
    let along_v = (dpy * dx.x - dpx * dy.x) * sign;
    let t = along_u - n * dot(n, along_u);
    let tt = dot(t, t);
    if area == 0.0 || tt <= 0.0 {
        return mat3x3<f32>(vec3<f32>(0.0), vec3<f32>(0.0), n);
    }
    let tangent = t * inverseSqrt(tt);
    let side = cross(n, tangent);
    return mat3x3<f32>(tangent, select(side, -side, dot(side, along_v) > 0.0), n);
}

fn surface_of(f: Fragment) -> Surface {
    var s = matt(f);
    let dx = dpdx(f.center_uv);
    let dy = dpdy(f.center_uv);
    let p = footprint(f.draw >> 4u, f.color.xy, dx, dy);
    s.uv = p.uv;
    s.side = f32(1u << (p.sides & 15u));
    s.lod = p.lod;
    s.shown_lod = clamp(p.lod, min(p.finest, p.coarsest), p.coarsest);
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
        var n = sample_map(normal_pages, p, normal).rgb * 2.0 - 1.0;
        if object_normals {
            if instanced {
                let s = stand_of(f.slot);
                n = turned(s, n) * inverseSqrt(dot(s.x, s.x));
            }
            s.normal = select(s.normal, normalize(n), dot(n, n) > SHORTEST * SHORTEST);
        } else {
            let z = sqrt(max(1.0 - dot(n.xy, n.xy), 0.0));
            let frame = tile_frame(s.normal, dpdx(f.center_position), dpdy(f.center_position), dx, dy);
            s.normal = normalize(frame * vec3<f32>(n.xy, z));
        }
    }
    let emissive = map_of(EMISSIVE);
    if emissive != NO_MAP {
        s.emissive = sample_map(emissive_pages, p, emissive).rgb;
    }
    return s;
}
