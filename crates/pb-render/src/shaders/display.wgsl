// The display rule: walks up the ancestors (design section 3). Twin of pb-lod's display.rs, in the same order
// of f32 operations; a test runs both. No entry points here: clusters.wgsl and the test add them.

struct View {
    clip_from_eye: mat4x4<f32>,
    // Grid cell of the eye, and the rest in world units.
    eye_cell: vec3<i32>,
    quantum: f32,
    eye_rest: vec3<f32>,
    // Number of clusters.
    clusters: u32,
    // Unit vector to the sun, world space.
    sun: vec3<f32>,
    // 0 shaded, 1 level, 2 cluster, 3 triangle, 4 albedo, 5 normals, 6 mips, 7 texels, 8 checker.
    color_mode: u32,
    // 1 paints back faces in pure magenta.
    show_back_faces: u32,
    // 1; 0 switches the morph off, so that levels snap.
    morph: f32,
    // 1 where vertices carry colours; else surfaces are grey.
    has_colors: u32,
    // 1 where vertices carry texture coordinates in place of colours.
    textured: u32,
    // By kind of map (base colour, ORM, normal, emissive) eight bits: its index, or 255 where the model has none.
    maps: u32,
    // Most samples along the longer axis of a pixel's footprint.
    anisotropy: f32,
    // 1 where the picture cannot hold light brighter than 1.
    tone_map: u32,
    // Where in `links` the clusters of the coarse buffer's vertices begin.
    first_owner: u32,
    // Where in `frame` the draws begin.
    first_draw: u32,
    reserved_0: u32,
    reserved_1: u32,
    reserved_2: u32,
}

struct Cluster {
    // Grid point that vertex offsets are relative to.
    origin: vec3<i32>,
    shift: u32,
    // First entry in `neighbours`.
    neighbours_first: u32,
    reserved_0: u32,
    reserved_1: u32,
    reserved_2: u32,
}

struct Level {
    // Vertices of this level: the prefix [0, vertices) of the cluster.
    vertices: u32,
    // Vertex v that dies at this level is heap[base + v]; wraps around.
    base: u32,
}

// Number of levels L. No uniform: where one bounds a loop, Mesa's lavapipe 22.3 makes a new shader for each frame and
// keeps them all.
override level_count: u32;
// Objects stand in several places.
override instanced: bool = false;

@group(0) @binding(0) var<uniform> view: View;
// Vertices of 16 bytes and index ranges, by chunk.
@group(0) @binding(1) var<storage, read> heap: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> clusters: array<Cluster>;
// cluster * L + level
@group(0) @binding(3) var<storage, read> levels: array<Level>;
// Switch distances D_i, world units; cluster * L + level
@group(0) @binding(4) var<storage, read> distances: array<f32>;
// Residency floors m_c, levels; by cluster
@group(0) @binding(5) var<storage, read> floors: array<f32>;
// Neighbour lists, then the cluster of each vertex of the coarse buffer.
@group(0) @binding(6) var<storage, read> links: array<u32>;
// Where there are instances: how those of the frame stand, 5 words each; then per draw cluster * 16 + level, and which of
// these it is for.
@group(0) @binding(7) var<storage, read> frame: array<vec4<u32>>;

// How an object stands in the world, and where the eye is for it.
struct Stand {
    // As in `View`.
    eye_cell: vec3<i32>,
    // What multiplies a distance in the object before it is compared with switch distances.
    stretch: f32,
    eye_rest: vec3<f32>,
    // The object's axes in the world, as long as its scale.
    x: vec3<f32>,
    y: vec3<f32>,
    z: vec3<f32>,
}

// That of an object which stands where its clusters are.
fn at_home() -> Stand {
    return Stand(view.eye_cell, 1.0, view.eye_rest, vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), vec3(0.0, 0.0, 1.0));
}

fn stand_of(slot: u32) -> Stand {
    let w = slot * 5u;
    return Stand(bitcast<vec3<i32>>(frame[w].xyz), bitcast<f32>(frame[w].w), bitcast<vec3<f32>>(frame[w + 1u].xyz),
        bitcast<vec3<f32>>(frame[w + 2u].xyz), bitcast<vec3<f32>>(frame[w + 3u].xyz),
        bitcast<vec3<f32>>(frame[w + 4u].xyz));
}

// A direction of the object in the world, times its scale.
fn turned(s: Stand, v: vec3<f32>) -> vec3<f32> {
    return s.x * v.x + s.y * v.y + s.z * v.z;
}

struct Displayed {
    // Relative to the eye, world units.
    position: vec3<f32>,
    // Not normalised.
    normal: vec3<f32>,
    // sRGB encoded, as stored; or u, v in tiles.
    color: vec4<f32>,
}

// Level of detail of `cluster` at distance `d`: max(m, i + (d - D_i) / (D_{i+1} - D_i)).
fn table_lod(cluster: u32, d: f32) -> f32 {
    let first = cluster * level_count;
    let last = level_count - 1u;
    var lod = f32(last);
    for (var i = 0u; i < last; i++) {
        let far = distances[first + i + 1u];
        if d < far {
            let near = distances[first + i];
            let w = (d - near) * (1.0 / (far - near));
            lod = f32(i) + clamp(w, 0.0, 1.0);
            break;
        }
    }
    return max(lod, floors[cluster]);
}

// Position relative to the eye, in the object: the integer part is exact, and quanta are powers of two.
fn position_of(s: Stand, cluster: u32, vertex: vec4<u32>) -> vec3<f32> {
    let c = clusters[cluster];
    let offset = vec3<u32>(vertex.x & 0xffffu, vertex.x >> 16u, vertex.y & 0xffffu);
    let grid = c.origin + vec3<i32>(offset << vec3<u32>(c.shift));
    return vec3<f32>(grid - s.eye_cell) * view.quantum - s.eye_rest;
}

// Level of detail of a position: the larger of its two clusters'. Both clusters of a border position evaluate
// the two tables in the order of the cluster indices, so that they run the same sums on the same numbers.
fn lod_of(s: Stand, cluster: u32, vertex: vec4<u32>, position: vec3<f32>) -> f32 {
    let d = sqrt(position.x * position.x + position.y * position.y + position.z * position.z) * s.stretch;
    let slot = vertex.z >> 24u;
    var other = cluster;
    if slot != 0u {
        other = links[clusters[cluster].neighbours_first + slot - 1u];
    }
    let a = table_lod(min(cluster, other), d);
    let b = table_lod(max(cluster, other), d);
    return max(a, b);
}

fn normal_of(vertex: vec4<u32>) -> vec3<f32> {
    let q = vec2<f32>(f32(vertex.z & 0xfffu), f32((vertex.z >> 12u) & 0xfffu));
    var n = q * (1.0 / 2047.0) - 1.0;
    let z = 1.0 - abs(n.x) - abs(n.y);
    if z < 0.0 {
        n = (1.0 - abs(n.yx)) * select(vec2<f32>(-1.0), vec2<f32>(1.0), n >= vec2<f32>(0.0));
    }
    return normalize(vec3<f32>(n, z));
}

// What the fourth word says: a colour, or texture coordinates in 1 / 65536 of the tile.
fn color_of_vertex(word: u32) -> vec4<f32> {
    if view.textured != 0u {
        return vec4<f32>(f32(word & 0xffffu), f32(word >> 16u), 0.0, 0.0) * (1.0 / 65536.0);
    }
    return unpack4x8unorm(word);
}

fn plain(cluster: u32, vertex: vec4<u32>, position: vec3<f32>) -> Displayed {
    return Displayed(position, normal_of(vertex), color_of_vertex(vertex.w));
}

// The level at which vertex `v` of `cluster` dies; it is at least `level`.
fn death(cluster: u32, v: u32, level: u32) -> u32 {
    let first = cluster * level_count;
    var i = level;
    while i < level_count - 1u && v < levels[first + i + 1u].vertices {
        i++;
    }
    return i;
}

fn stored(cluster: u32, v: u32, dies: u32) -> vec4<u32> {
    return heap[levels[cluster * level_count + dies].base + v];
}

// Where vertex `index` of `cluster` is shown. The level of the index buffer that draws it plays no part: at the
// levels below its death a vertex is its own parent. Its chunk and all coarser ones must be resident (I5).
//
// First past the ancestors whose own lod has left them behind; then a mix with the ancestors that follow, each
// weighed by its own lod, so that the place is continuous whichever of them reaches the next level first.
//
// One loop with one copy of each sum: a finer cluster that has walked up to a vertex and a coarser one that starts
// there run the very same instructions on it. In the space of the object.
fn display(s: Stand, cluster: u32, index: u32) -> Displayed {
    let last = level_count - 1u;
    var v = index;
    var level = 0u;
    var weight = 1.0;
    var passing = true;
    var here: Displayed;
    var shown: Displayed;
    loop {
        level = death(cluster, v, level);
        let vertex = stored(cluster, v, level);
        let position = position_of(s, cluster, vertex);
        let next = plain(cluster, vertex, position);
        if passing {
            shown = next;
        } else {
            shown.position += (next.position - here.position) * weight;
            shown.normal += (next.normal - here.normal) * weight;
            shown.color += (next.color - here.color) * weight;
        }
        here = next;
        if level == last {
            break;
        }
        let t = lod_of(s, cluster, vertex, position);
        passing = passing && t >= f32(level + 1u);
        if !passing {
            weight *= clamp(t - f32(level), 0.0, 1.0) * view.morph;
            if weight == 0.0 {
                break;
            }
        }
        v = vertex.y >> 16u;
        level++;
    }
    return shown;
}
