// The display rule: walks up the ancestors (design section 3). Twin of pb-lod's display.rs, in the same order
// of f32 operations; a test runs both. No entry points here: clusters.wgsl and the test add them.

struct View {
    clip_from_eye: mat4x4<f32>,
    // Grid cell of the eye, and the rest in world units.
    eye_cell: vec3<i32>,
    quantum: f32,
    eye_rest: vec3<f32>,
    // Number of levels L.
    levels: u32,
    // Unit vector to the sun, world space.
    sun: vec3<f32>,
    // 0 shaded, 1 level, 2 cluster, 3 triangle.
    color_mode: u32,
    // 1 paints back faces in pure magenta.
    show_back_faces: u32,
    // 1; 0 switches the morph off, so that levels snap.
    morph: f32,
    reserved: vec2<u32>,
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
@group(0) @binding(6) var<storage, read> neighbours: array<u32>;
// Cluster of each vertex of the coarse buffer.
@group(0) @binding(7) var<storage, read> coarse_clusters: array<u32>;

struct Displayed {
    // Relative to the eye, world units.
    position: vec3<f32>,
    // Not normalised.
    normal: vec3<f32>,
    // sRGB encoded, as stored.
    color: vec4<f32>,
}

// Level of detail of `cluster` at distance `d`: max(m, i + (d - D_i) / (D_{i+1} - D_i)).
fn table_lod(cluster: u32, d: f32) -> f32 {
    let first = cluster * view.levels;
    let last = view.levels - 1u;
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

// Position relative to the eye: the integer part is exact, and quanta are powers of two.
fn position_of(cluster: u32, vertex: vec4<u32>) -> vec3<f32> {
    let c = clusters[cluster];
    let offset = vec3<u32>(vertex.x & 0xffffu, vertex.x >> 16u, vertex.y & 0xffffu);
    let grid = c.origin + vec3<i32>(offset << vec3<u32>(c.shift));
    return vec3<f32>(grid - view.eye_cell) * view.quantum - view.eye_rest;
}

// Level of detail of a position: the larger of its two clusters'. Both clusters of a border position evaluate
// the two tables in the order of the cluster indices, so that they run the same sums on the same numbers.
fn lod_of(cluster: u32, vertex: vec4<u32>, position: vec3<f32>) -> f32 {
    let d = sqrt(position.x * position.x + position.y * position.y + position.z * position.z);
    let slot = vertex.z >> 24u;
    var other = cluster;
    if slot != 0u {
        other = neighbours[clusters[cluster].neighbours_first + slot - 1u];
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

fn plain(cluster: u32, vertex: vec4<u32>, position: vec3<f32>) -> Displayed {
    return Displayed(position, normal_of(vertex), unpack4x8unorm(vertex.w));
}

// Where vertex `index` of `cluster` is shown. The level of the index buffer that draws it plays no part: at the
// levels below its death a vertex is its own parent. Its chunk and all coarser ones must be resident (I5).
fn display(cluster: u32, index: u32) -> Displayed {
    let first = cluster * view.levels;
    let last = view.levels - 1u;
    var v = index;
    var level = 0u;
    loop {
        // The level at which v dies.
        while level < last && v < levels[first + level + 1u].vertices {
            level++;
        }
        let vertex = heap[levels[first + level].base + v];
        let position = position_of(cluster, vertex);
        if level == last {
            return plain(cluster, vertex, position);
        }
        let t = lod_of(cluster, vertex, position);
        let parent = vertex.y >> 16u;
        level++;
        if t < f32(level) {
            let w = max(t - f32(level - 1u), 0.0) * view.morph;
            return mixed(cluster, plain(cluster, vertex, position), parent, level, w);
        }
        v = parent;
    }
    return Displayed();
}

// `fine` on its way to vertex `parent`, which lives at `level`.
fn mixed(cluster: u32, fine: Displayed, parent: u32, level: u32, w: f32) -> Displayed {
    let first = cluster * view.levels;
    var home = level;
    while home < view.levels - 1u && parent < levels[first + home + 1u].vertices {
        home++;
    }
    let vertex = heap[levels[first + home].base + parent];
    let b = plain(cluster, vertex, position_of(cluster, vertex));
    return Displayed(
        fine.position + (b.position - fine.position) * w,
        fine.normal + (b.normal - fine.normal) * w,
        fine.color + (b.color - fine.color) * w,
    );
}
