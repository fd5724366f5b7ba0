//! Every shader is parsed and validated, and its structs are compared with Rust's, without an adapter.

use naga::proc::Layouter;
use naga::valid::{Capabilities, ValidationFlags, Validator};
use pb_render::{ClusterGpu, LevelGpu, ShaderKind, ViewUniform, shader_source};
use std::mem::offset_of;

fn parsed(source: &str) -> naga::Module {
    let module = naga::front::wgsl::parse_str(source).unwrap_or_else(|e| panic!("{}", e.emit_to_string(source)));
    let capabilities = Capabilities::PRIMITIVE_INDEX;
    let mut validator = Validator::new(ValidationFlags::all(), capabilities);
    validator.validate(&module).unwrap_or_else(|e| panic!("{}", e.emit_to_string(source)));
    module
}

#[test]
fn shaders_are_valid_with_and_without_primitive_index_and_textures() {
    for (primitive_index, textured) in [(false, false), (true, false), (false, true), (true, true)] {
        let module = parsed(&shader_source(ShaderKind { primitive_index, textured }));
        let mut entries: Vec<&str> = module.entry_points.iter().map(|e| e.name.as_str()).collect();
        entries.sort_unstable();
        assert_eq!(entries, ["fs_main", "vs_cluster", "vs_coarse"]);
    }
}

/// Offsets of a struct's members and its size, as WGSL lays it out.
fn wgsl_layout(module: &naga::Module, name: &str) -> (Vec<(String, u32)>, u32) {
    let mut layouter = Layouter::default();
    layouter.update(module.to_ctx()).unwrap();
    let (handle, ty) = module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name)).unwrap();
    let naga::TypeInner::Struct { members, .. } = &ty.inner else { panic!("{name} is no struct") };
    let offsets = members.iter().map(|m| (m.name.clone().unwrap(), m.offset)).collect();
    (offsets, layouter[handle].to_stride())
}

/// `(name, offset)` of every field.
macro_rules! rust_layout {
    ($type:ty, $($field:ident),+) => {
        (vec![$((stringify!($field).to_string(), offset_of!($type, $field) as u32)),+], size_of::<$type>() as u32)
    };
}

#[test]
fn structs_lie_in_memory_as_the_shader_reads_them() {
    let module = parsed(&shader_source(ShaderKind { primitive_index: false, textured: true }));
    let view = rust_layout!(
        ViewUniform,
        clip_from_eye,
        eye_cell,
        quantum,
        eye_rest,
        clusters,
        sun,
        color_mode,
        show_back_faces,
        morph,
        has_colors,
        textured,
        maps,
        anisotropy,
        tone_map,
        first_owner,
        first_draw
    );
    let (mut fields, size) = wgsl_layout(&module, "View");
    fields.truncate(view.0.len());
    assert_eq!((fields, size), view);
    assert_eq!(wgsl_layout(&module, "Level"), rust_layout!(LevelGpu, vertices, base));
    let (mut fields, size) = wgsl_layout(&module, "Cluster");
    fields.truncate(3);
    let (rust, rust_size) = rust_layout!(ClusterGpu, origin, shift, neighbours_first);
    assert_eq!((fields, size), (rust, rust_size));
}
