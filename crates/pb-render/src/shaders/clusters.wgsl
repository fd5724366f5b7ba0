// Draws clusters, one draw each, and ranges of the coarse buffer. Needs display.wgsl before it.

struct Fragment {
    @invariant @builtin(position) clip: vec4<f32>,
    // Relative to the eye, world units.
    @location(0) @interpolate(perspective, centroid) position: vec3<f32>,
    @location(1) @interpolate(perspective, centroid) normal: vec3<f32>,
    // sRGB encoded; or u, v in tiles.
    @location(2) @interpolate(perspective, centroid) color: vec4<f32>,
    // cluster * 16 + level
    @location(3) @interpolate(flat) draw: u32,
    // Some vertex of the triangle: tells triangles apart where there is no primitive index.
    @location(4) @interpolate(flat) vertex: u32,
    // Position and u, v at the pixel's centre, also where it lies outside the triangle: for derivatives.
    @location(5) @interpolate(perspective, center) center_position: vec3<f32>,
    @location(6) @interpolate(perspective, center) center_uv: vec2<f32>,
    // Which of the frame's stands it is for, where there are instances.
    @location(7) @interpolate(flat) slot: u32,
}

fn fragment_of(shown: Displayed, draw: u32, vertex: u32, slot: u32) -> Fragment {
    let clip = view.clip_from_eye * vec4<f32>(shown.position, 1.0);
    return Fragment(clip, shown.position, shown.normal, shown.color, draw, vertex, shown.position, shown.color.xy, slot);
}

// From the space of the object to the world.
fn placed(s: Stand, shown: Displayed) -> Displayed {
    return Displayed(turned(s, shown.position), turned(s, shown.normal), shown.color);
}

// Index: local to the cluster. Instance: cluster * 16 + level; or the number of the draw, where there are instances.
@vertex
fn vs_cluster(@builtin(vertex_index) index: u32, @builtin(instance_index) draw: u32) -> Fragment {
    if instanced {
        let d = frame[view.first_draw + draw];
        let s = stand_of(d.y);
        return fragment_of(placed(s, display(s, d.x >> 4u, index)), d.x, index, d.y);
    }
    return fragment_of(display(at_home(), draw >> 4u, index), draw, index, 0u);
}

// Index: vertex of the coarse buffer, which lies at the start of the heap. Nothing is above the coarsest level,
// so the walk ends where it starts. Instance: one of the frame's stands, where there are instances.
@vertex
fn vs_coarse(@builtin(vertex_index) index: u32, @builtin(instance_index) slot: u32) -> Fragment {
    let cluster = links[view.first_owner + index];
    let vertex = heap[index];
    let draw = cluster * 16u + level_count - 1u;
    if instanced {
        let s = stand_of(slot);
        return fragment_of(placed(s, plain(cluster, vertex, position_of(s, cluster, vertex))), draw, index, slot);
    }
    let shown = plain(cluster, vertex, position_of(at_home(), cluster, vertex));
    return fragment_of(shown, draw, index, 0u);
}
