// Samples the tiles: filters between texels, mips and along the longer axis of a pixel's footprint (design section
// 5, docs/decisions/007-textures.md). Needs display.wgsl before it.

// Floors (f32 bits) by cluster; then by cluster the sides (4 bits log2 of the tile, 4 bits first level by map) and
// the first place; then places by cluster, map, level: x and y in 4 texels, 10 bits each, and the layer.
@group(0) @binding(8) var<storage, read> tiles: array<u32>;
@group(1) @binding(0) var bilinear: sampler;
@group(1) @binding(1) var base_color_pages: texture_2d_array<f32>;
@group(1) @binding(2) var orm_pages: texture_2d_array<f32>;
@group(1) @binding(3) var normal_pages: texture_2d_array<f32>;
@group(1) @binding(4) var emissive_pages: texture_2d_array<f32>;

const BASE_COLOR = 0u;
const ORM = 1u;
const NORMAL = 2u;
const EMISSIVE = 3u;
const NO_MAP = 255u;
// log2 of the narrowest tile in which charts are apart, 32 texels: coarser levels mix charts and are not drawn.
const CHARTS_APART = 5u;

// What a pixel covers of a tile.
struct Footprint {
    cluster: u32,
    // Centre, in tiles.
    uv: vec2<f32>,
    // Longer axis, in tiles, and its length in texels of level 0.
    axis: vec2<f32>,
    length: f32,
    // Level whose texels are as wide as the shorter axis, or as the longer one's part.
    lod: f32,
    // Finest level that is resident.
    finest: f32,
    // Coarsest level that is stored, 4 x 4 texels, and that is drawn.
    last: f32,
    coarsest: f32,
    sides: u32,
    first_place: u32,
}

// Singular values of the derivatives: Heckbert 1989, "Fundamentals of Texture Mapping and Image Warping", section 3.5.
fn footprint(cluster: u32, uv: vec2<f32>, dx: vec2<f32>, dy: vec2<f32>) -> Footprint {
    let sides = tiles[view.clusters + cluster * 2u];
    let side = f32(1u << (sides & 15u));
    let a = dx * side;
    let b = dy * side;
    let xx = a.x * a.x + b.x * b.x;
    let xy = a.x * a.y + b.x * b.y;
    let yy = a.y * a.y + b.y * b.y;
    let middle = (xx + yy) * 0.5;
    let spread = sqrt((xx - yy) * (xx - yy) * 0.25 + xy * xy);
    let long = sqrt(middle + spread);
    let short = sqrt(max(middle - spread, 0.0));
    // Either row of (M - least) points along the longer axis; the longer row is the exacter one.
    let least = middle - spread;
    let row = select(vec2<f32>(xy, yy - least), vec2<f32>(xx - least, xy), xx >= yy);
    let l = length(row);
    let direction = select(vec2<f32>(1.0, 0.0), row / max(l, 1e-30), l > 1e-30);
    let lod = log2(max(max(short, long / view.anisotropy), 1e-6));
    let last = f32((sides & 15u) - 2u);
    let coarsest = f32(max(sides & 15u, CHARTS_APART) - CHARTS_APART);
    let first_place = tiles[view.clusters + cluster * 2u + 1u];
    let finest = bitcast<f32>(tiles[cluster]);
    return Footprint(cluster, uv, direction * (long / side), long, lod, finest, last, coarsest, sides, first_place);
}

// Index of a kind of map among the model's, or NO_MAP.
fn map_of(kind: u32) -> u32 {
    return (view.maps >> (kind * 8u)) & 255u;
}

// The level that is sampled of a map: between the finest that is there and the coarsest that is drawn; of a map of fewer
// texels its first.
fn lod_in_map(p: Footprint, map: u32) -> f32 {
    let first = f32((p.sides >> (4u + 4u * map)) & 15u);
    let coarsest = max(first, p.coarsest);
    return clamp(p.lod, min(max(first, p.finest), coarsest), coarsest);
}

// One level of a map: the mean of samples along the longer axis.
fn sample_level(pages: texture_2d_array<f32>, p: Footprint, map: u32, level: u32, taps: u32) -> vec4<f32> {
    let place = tiles[p.first_place + map * (u32(p.last) + 1u) + level];
    let side = f32((1u << (p.sides & 15u)) >> level);
    let corner = vec2<f32>(f32(place & 1023u), f32((place >> 10u) & 1023u)) * 4.0;
    let scale = 1.0 / f32(textureDimensions(pages).x);
    var sum = vec4<f32>(0.0);
    for (var i = 0u; i < taps; i++) {
        let along = (f32(i) + 0.5) / f32(taps) - 0.5;
        // Half a texel from the rim, so that no neighbour in the page is touched.
        let texel = clamp((p.uv + p.axis * along) * side, vec2<f32>(0.5), vec2<f32>(side - 0.5));
        sum += textureSampleLevel(pages, bilinear, (corner + texel) * scale, place >> 20u, 0.0);
    }
    return sum / f32(taps);
}

fn sample_map(pages: texture_2d_array<f32>, p: Footprint, map: u32) -> vec4<f32> {
    let lod = lod_in_map(p, map);
    let level = floor(lod);
    let taps = u32(clamp(ceil(p.length * exp2(-level) - 0.01), 1.0, view.anisotropy));
    var color = sample_level(pages, p, map, u32(level), taps);
    if lod > level {
        let coarser = sample_level(pages, p, map, u32(level) + 1u, (taps + 1u) / 2u);
        color = mix(color, coarser, lod - level);
    }
    return color;
}
