//! Tests that `geometry.wesl` reads the output of `pack_mesh`.

use super::{
    attributes::{encode_normal, encode_tangent},
    tests::{fibonacci_sphere, triangle_mesh},
    *,
};
use crate::scene::test_gpu;
use bevy::math::{Vec3Swizzles, Vec4};

const MAIN: &str = "
import package::scene::geometry::{
    has_colors, has_normals, has_tangents, has_uv, load_color, load_normal, load_position, load_tangent, load_triangle, load_uv,
};

@group(0) @binding(0) var<storage, read_write> output: array<u32>;

const BASE: u32 = 36u;

@compute @workgroup_size(64)
fn main(@builtin(local_invocation_index) thread: u32) {
    // Beyond the last vertex, the last one is read.
    for (var vertex = thread; vertex < arrayLength(&output) / 20u; vertex += 64u) {
        let word = vertex * 20u;
        let position = bitcast<vec3<u32>>(load_position(BASE, vertex));
        let normal = bitcast<vec3<u32>>(load_normal(BASE, vertex));
        let tangent = bitcast<vec4<u32>>(load_tangent(BASE, vertex));
        let uv = bitcast<vec4<u32>>(vec4<f32>(load_uv(BASE, vertex, 0u), load_uv(BASE, vertex, 1u)));
        let color = bitcast<vec4<u32>>(load_color(BASE, vertex));
        for (var i = 0u; i < 3u; i += 1u) {
            output[word + i] = position[i];
            output[word + 3u + i] = normal[i];
        }
        for (var i = 0u; i < 4u; i += 1u) {
            output[word + 6u + i] = tangent[i];
            output[word + 10u + i] = uv[i];
            output[word + 14u + i] = color[i];
        }
        let triangle = load_triangle(BASE, vertex);
        output[word + 18u] = triangle.x | (triangle.y << 10u) | (triangle.z << 20u);
        output[word + 19u] = u32(has_normals(BASE)) | (u32(has_tangents(BASE)) << 1u) | (u32(has_uv(BASE, 0u)) << 2u)
            | (u32(has_uv(BASE, 1u)) << 3u) | (u32(has_colors(BASE)) << 4u);
    }
}
";

fn wgsl() -> String {
    let modules = [
        ("scene/geometry.wesl", include_str!("../geometry.wesl")),
        ("scene/bindings.wesl", include_str!("../bindings.wesl")),
        ("scene/types.wesl", include_str!("../types.wesl")),
    ];
    test_gpu::link(MAIN, &modules, &[])
}

#[test]
fn shader_is_valid() {
    let module = naga::front::wgsl::parse_str(&wgsl())
        .map_err(|error| error.emit_to_string(&wgsl()))
        .unwrap();
    // Needed to unpack half floats, which every WebGPU device can.
    let capabilities = naga::valid::Capabilities::SHADER_FLOAT16_IN_FLOAT32;
    naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities)
        .validate(&module)
        .unwrap();
}

#[derive(Debug)]
struct Read {
    position: Vec3,
    normal: Vec3,
    tangent: Vec4,
    uv: Vec4,
    color: Vec4,
    triangle: [u32; 3],
    has: u32,
}

/// Returns what the shader reads for the first `count` vertices and triangles; `None` without an adapter.
fn read_back(mesh: &Mesh, count: usize) -> Option<Vec<Read>> {
    let (device, queue) = test_gpu::device()?;
    let mut words = vec![0xdead_beef; 36];
    words.extend(pack_mesh(mesh).unwrap().words);
    let output = test_gpu::run(&device, &queue, wgsl(), &words, count * 20);
    let float = |row: &[u32], i: usize| f32::from_bits(row[i]);
    let vec3 = |row: &[u32], i: usize| Vec3::new(float(row, i), float(row, i + 1), float(row, i + 2));
    let vec4 = |row: &[u32], i: usize| vec3(row, i).extend(float(row, i + 3));
    let read = output.chunks_exact(20).map(|row| Read {
        position: vec3(row, 0),
        normal: vec3(row, 3),
        tangent: vec4(row, 6),
        uv: vec4(row, 10),
        color: vec4(row, 14),
        triangle: [row[18] & 0x3ff, (row[18] >> 10) & 0x3ff, row[18] >> 20],
        has: row[19],
    });
    Some(read.collect())
}

/// In degrees, exact near zero.
fn angle(a: Vec3, b: Vec3) -> f32 {
    a.as_dvec3()
        .normalize()
        .angle_between(b.as_dvec3().normalize())
        .to_degrees() as f32
}

#[test]
fn shader_reads_every_attribute() {
    let directions = fibonacci_sphere(1000);
    let vector = |scale: f32| directions.iter().map(|d| (*d * scale).to_array()).collect::<Vec<_>>();
    let sign = |i: usize| if i.is_multiple_of(2) { 1.0 } else { -1.0 };
    let tangents: Vec<[f32; 4]> = directions
        .iter()
        .enumerate()
        .map(|(i, d)| d.zxy().extend(sign(i)).to_array())
        .collect();
    let uv = |scale: f32| (0..1000).map(|i| [i as f32 * scale, -3.5]).collect::<Vec<_>>();
    let colors: Vec<[f32; 4]> = (0..1000).map(|i| [i as f32, 0.25, 4.5, 250.0 / 255.0]).collect();
    let mesh = triangle_mesh(vector(10.0))
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, vector(1.0))
        .with_inserted_attribute(Mesh::ATTRIBUTE_TANGENT, tangents)
        .with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, uv(0.25))
        .with_inserted_attribute(Mesh::ATTRIBUTE_UV_1, uv(0.5))
        .with_inserted_attribute(Mesh::ATTRIBUTE_COLOR, colors)
        .with_inserted_indices(Indices::U32((0..999).rev().collect()));
    let Some(read) = read_back(&mesh, 1003) else { return };
    let (mut worst_normal, mut worst_tangent) = (0.0_f32, 0.0_f32);
    for (i, row) in read.iter().enumerate() {
        let v = i.min(999);
        assert_eq!(row.position, directions[v] * 10.0);
        worst_normal = worst_normal.max(angle(row.normal, directions[v]));
        worst_tangent = worst_tangent.max(angle(row.tangent.truncate(), directions[v].zxy()));
        assert!((row.normal.length() - 1.0).abs() < 1e-5 && (row.tangent.truncate().length() - 1.0).abs() < 1e-5);
        assert_eq!(row.tangent.w, sign(v));
        assert_eq!(row.uv, Vec4::new(v as f32 * 0.25, -3.5, v as f32 * 0.5, -3.5));
        assert!(
            row.color
                .abs_diff_eq(Vec4::new(v as f32, 0.25, 4.5, 250.0 / 255.0), 1e-6)
        );
        let first = 998 - 3 * i.min(332) as u32;
        assert_eq!(row.triangle, [first, first - 1, first - 2]);
        assert_eq!(row.has, 0b11111);
    }
    assert!(
        worst_normal < 0.01 && worst_tangent < 0.01,
        "{worst_normal} and {worst_tangent} degrees"
    );
}

#[test]
fn shader_reads_defaults_for_absent_attributes() {
    for mesh in [triangle_mesh(vec![[1.0, 2.0, 3.0]; 3]), triangle_mesh(Vec::new())] {
        let Some(read) = read_back(&mesh, 5) else { return };
        for row in read {
            assert_eq!(row.has, 0);
            assert!(row.position == Vec3::new(1.0, 2.0, 3.0) || row.position == Vec3::ZERO);
            assert_eq!((row.normal, row.tangent), (Vec3::Z, Vec4::new(1.0, 0.0, 0.0, 1.0)));
            assert_eq!((row.uv, row.color), (Vec4::ZERO, Vec4::ONE));
        }
    }
}

#[test]
fn shader_decodes_corners_of_the_octahedron() {
    let axes = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
    let mesh = triangle_mesh(axes.map(|axis| axis.to_array()).to_vec())
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, axes.map(|axis| axis.to_array()).to_vec())
        .with_inserted_attribute(
            Mesh::ATTRIBUTE_TANGENT,
            axes.map(|axis| axis.extend(-1.0).to_array()).to_vec(),
        );
    assert_eq!(encode_normal(Vec3::X), 0x7fff);
    assert_eq!(encode_tangent(Vec3::Y, true), 0xffff_0000);
    let Some(read) = read_back(&mesh, 6) else { return };
    for (row, axis) in read.iter().zip(axes) {
        assert!(
            angle(row.normal, axis) < 0.005 && angle(row.tangent.truncate(), axis) < 0.005,
            "{row:?}"
        );
        assert_eq!(row.tangent.w, -1.0);
    }
}
