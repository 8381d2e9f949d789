use super::{
    attributes::{encode_normal, encode_tangent},
    *,
};
use bevy::{
    asset::RenderAssetUsages,
    math::{Vec2, Vec3A, Vec3Swizzles},
    mesh::{MeshVertexAttribute, VertexFormat, octahedral_decode_signed},
    shape::Aabb3d,
};
use proptest::prelude::*;
use std::f32::consts::PI;

pub(super) fn triangle_mesh(positions: Vec<[f32; 3]>) -> Mesh {
    mesh_of(PrimitiveTopology::TriangleList, positions)
}

fn mesh_of(topology: PrimitiveTopology, positions: Vec<[f32; 3]>) -> Mesh {
    Mesh::new(topology, RenderAssetUsages::all()).with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions)
}

/// Inserts an attribute in the format of the values.
fn with(mesh: Mesh, attribute: MeshVertexAttribute, values: VertexAttributeValues) -> Mesh {
    mesh.with_inserted_attribute(
        MeshVertexAttribute {
            format: VertexFormat::from(&values),
            ..attribute
        },
        values,
    )
}

/// Evenly spread unit vectors.
pub(super) fn fibonacci_sphere(count: usize) -> Vec<Vec3> {
    let golden = PI * (5.0_f32.sqrt() - 1.0);
    let point = |i: usize| {
        let y = 1.0 - 2.0 * (i as f32 + 0.5) / count as f32;
        let (sin, cos) = (golden * i as f32).sin_cos();
        Vec3::new(cos * (1.0 - y * y).sqrt(), y, sin * (1.0 - y * y).sqrt()).normalize()
    };
    (0..count).map(point).collect()
}

fn line(count: usize) -> Vec<[f32; 3]> {
    (0..count).map(|i| [i as f32, (i * i) as f32, 1.0]).collect()
}

fn words(packed: &PackedMesh, offset: u32, per_vertex: usize) -> &[u32] {
    &packed.words[offset as usize..][..packed.vertex_count as usize * per_vertex]
}

fn floats(packed: &PackedMesh, offset: u32) -> Vec<f32> {
    words(packed, offset, 2)
        .iter()
        .map(|word| f32::from_bits(*word))
        .collect()
}

fn colors(packed: &PackedMesh) -> Vec<[f32; 4]> {
    let half = |word: u32| f32::from_bits((word & 0x7fff) << 13) * 2.0_f32.powi(112);
    packed
        .colors()
        .iter()
        .map(|[first, last]| [half(*first), half(first >> 16), half(*last), (last >> 24) as f32])
        .collect()
}

fn decoded_normal(word: u32) -> Vec3 {
    let snorm = |bits: u32| f32::from(bits as u16 as i16) / 32767.0;
    octahedral_decode_signed(Vec2::new(snorm(word), snorm(word >> 16)))
}

fn decoded_tangent(word: u32) -> (Vec3, bool) {
    let y = ((word >> 16) & 0x7fff) as f32 / 32767.0 * 2.0 - 1.0;
    (
        octahedral_decode_signed(Vec2::new(f32::from(word as u16 as i16) / 32767.0, y)),
        word >> 31 == 1,
    )
}

fn degrees(a: Vec3, b: Vec3) -> f64 {
    a.as_dvec3()
        .normalize()
        .angle_between(b.as_dvec3().normalize())
        .to_degrees()
}

#[test]
fn layout_follows_the_header() {
    let mesh = with(
        triangle_mesh(line(4)).with_inserted_attribute(Mesh::ATTRIBUTE_UV_1, vec![[0.5, 0.25]; 4]),
        Mesh::ATTRIBUTE_COLOR,
        VertexAttributeValues::Float32x3(vec![[1.0, 0.5, 9.0]; 4]),
    )
    .with_inserted_indices(Indices::U16(vec![0, 1, 2, 3, 2, 1, 0]));
    let packed = pack_mesh(&mesh).unwrap();
    assert_eq!(packed.words[..12], [4, 2, 0, 12, 24, 0, 0, 0, 30, 38, 0, 0]);
    assert_eq!(packed.words.len(), 46);
    assert_eq!(packed.positions(), line(4));
    assert_eq!(packed.indices(), [0, 1, 2, 3, 2, 1]);
    assert_eq!(
        packed.bounds,
        Bounds {
            min: Vec3::new(0.0, 0.0, 1.0),
            max: Vec3::new(3.0, 9.0, 1.0)
        }
    );
    assert_eq!(floats(&packed, packed.offsets.uv1)[..2], [0.5, 0.25]);
    assert_eq!(colors(&packed)[3], [1.0, 0.5, 9.0, 255.0]);
    assert!(packed.defects.is_empty() && packed.deformation.is_none());
}

#[test]
fn lists_without_indices_drop_the_remainder() {
    let packed = pack_mesh(&triangle_mesh(line(8))).unwrap();
    assert_eq!(packed.triangles(), [[0, 1, 2], [3, 4, 5]]);
}

#[test]
fn strips_alternate_and_restart() {
    let strip = mesh_of(PrimitiveTopology::TriangleStrip, line(6));
    assert_eq!(
        pack_mesh(&strip).unwrap().triangles(),
        [[0, 1, 2], [2, 1, 3], [2, 3, 4], [4, 3, 5]]
    );
    let expected = [[0, 1, 2], [2, 1, 3], [1, 2, 3], [3, 2, 4]];
    let u16s = strip
        .clone()
        .with_inserted_indices(Indices::U16(vec![0, 1, 2, 3, 0xffff, 5, 0xffff, 1, 2, 3, 4]));
    assert_eq!(pack_mesh(&u16s).unwrap().triangles(), expected);
    let end = u32::MAX;
    let u32s = strip.with_inserted_indices(Indices::U32(vec![0, 1, 2, 3, end, end, 1, 2, 3, 4, end]));
    let packed = pack_mesh(&u32s).unwrap();
    assert_eq!(packed.triangles(), expected);
    assert!(packed.defects.is_empty());
    // A list has no restart index.
    let list = triangle_mesh(line(3)).with_inserted_indices(Indices::U16(vec![0, 1, 0xffff, 0, 1, 2]));
    let packed = pack_mesh(&list).unwrap();
    assert_eq!((packed.triangle_count, packed.defects.out_of_range_triangles), (1, 1));
}

#[test]
fn other_topologies_and_missing_data_are_errors() {
    for topology in [
        PrimitiveTopology::PointList,
        PrimitiveTopology::LineList,
        PrimitiveTopology::LineStrip,
    ] {
        let error = pack_mesh(&mesh_of(topology, line(3))).unwrap_err();
        assert!(error.to_string().contains("TriangleList"), "{error}");
    }
    let bare = Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::all());
    assert!(matches!(pack_mesh(&bare), Err(GeometryError::MissingPositions)));
    let mut mesh = triangle_mesh(line(3));
    let extracted = mesh.take_gpu_data().unwrap();
    assert!(matches!(pack_mesh(&mesh), Err(GeometryError::Extracted)));
    assert_eq!(pack_mesh(&extracted).unwrap().triangle_count, 1);
}

#[test]
fn degenerate_meshes_pack() {
    for positions in [Vec::new(), line(1), line(2)] {
        let packed = pack_mesh(&triangle_mesh(positions.clone())).unwrap();
        assert_eq!(
            (packed.triangle_count, packed.vertex_count as usize),
            (0, positions.len())
        );
        assert_eq!(packed.bounds, Bounds::default());
        assert!(packed.words.len() >= MIN_WORDS as usize && packed.indices().is_empty());
    }
    // Triangles without area are left to the tracer.
    assert_eq!(pack_mesh(&triangle_mesh(vec![[1.0; 3]; 3])).unwrap().triangle_count, 1);
}

#[test]
fn uneven_attributes_are_cut_to_the_shortest() {
    let mesh = triangle_mesh(line(6)).with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, vec![[0.0, 0.0]; 4]);
    let packed = pack_mesh(&mesh.with_inserted_indices(Indices::U32(vec![0, 1, 2, 3, 4, 5]))).unwrap();
    assert_eq!(
        (
            packed.vertex_count,
            packed.triangle_count,
            packed.defects.out_of_range_triangles
        ),
        (4, 1, 1)
    );
    assert!(packed.defects.uneven_attributes && packed.defects.to_string().contains("shortest"));
    let empty = triangle_mesh(line(6)).with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, Vec::<[f32; 3]>::new());
    assert_eq!(
        pack_mesh(&empty).unwrap().words[..12],
        [0, 0, 0, 12, 12, 0, 0, 0, 0, 0, 0, 0]
    );
}

#[test]
fn non_finite_positions_drop_their_triangles() {
    for bad in [f32::NAN, f32::INFINITY, -f32::INFINITY, 1e30] {
        let mut positions = line(7);
        positions[1][2] = bad;
        let packed = pack_mesh(&triangle_mesh(positions)).unwrap();
        assert_eq!(
            (packed.triangles(), packed.defects.non_finite_triangles),
            (&[[3, 4, 5]][..], 1)
        );
        assert!(packed.positions().as_flattened().iter().all(|x| x.is_finite()));
        assert_eq!(packed.bounds.min, Vec3::new(3.0, 9.0, 1.0));
    }
}

#[test]
fn invalid_values_become_neutral() {
    let bad = f32::NAN;
    // In the plane z = 0, counter-clockwise seen from +Z, then clockwise.
    let positions = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [0.0, 1.0], [1.0, 0.0]];
    let mesh = triangle_mesh(positions.map(|[x, y]| [x, y, 0.0]).to_vec())
        .with_inserted_attribute(
            Mesh::ATTRIBUTE_NORMAL,
            vec![
                [0.0; 3],
                [bad; 3],
                [1e30, 0.0, 0.0],
                [0.0; 3],
                [1e-40, 0.0, 0.0],
                [0.0, f32::INFINITY, 0.0],
            ],
        )
        .with_inserted_attribute(Mesh::ATTRIBUTE_TANGENT, vec![[0.0, 0.0, 0.0, -1.0]; 6])
        .with_inserted_attribute(
            Mesh::ATTRIBUTE_UV_0,
            vec![
                [bad, 1.0],
                [2.0, 3.0],
                [0.0, f32::INFINITY],
                [0.0; 2],
                [0.0; 2],
                [0.0; 2],
            ],
        )
        .with_inserted_attribute(Mesh::ATTRIBUTE_COLOR, vec![[bad, 0.0, 0.0, 0.0]; 6]);
    let packed = pack_mesh(&mesh).unwrap();
    let normals: Vec<Vec3> = words(&packed, packed.offsets.normals, 1)
        .iter()
        .map(|w| decoded_normal(*w))
        .collect();
    for (normal, expected) in normals
        .iter()
        .zip([Vec3::Z, Vec3::Z, Vec3::X, Vec3::NEG_Z, Vec3::X, Vec3::NEG_Z])
    {
        assert!(degrees(*normal, expected) < 0.01, "{normals:?}");
    }
    for (word, normal) in words(&packed, packed.offsets.tangents, 1).iter().zip(&normals) {
        let (tangent, flipped) = decoded_tangent(*word);
        assert!(flipped && tangent.dot(*normal).abs() < 1e-3);
    }
    assert_eq!(floats(&packed, packed.offsets.uv0)[..6], [0.0, 0.0, 2.0, 3.0, 0.0, 0.0]);
    assert_eq!(colors(&packed), [[1.0, 1.0, 1.0, 255.0]; 6]);
    assert_eq!(packed.defects.replaced_values, 4 + 6 + 2 + 6);
}

#[test]
fn directions_survive_packing() {
    let (mut worst_normal, mut worst_tangent) = (0.0_f64, 0.0_f64);
    for (i, direction) in fibonacci_sphere(200_000).into_iter().enumerate() {
        worst_normal = worst_normal.max(degrees(decoded_normal(encode_normal(direction)), direction));
        let flipped = i.is_multiple_of(3);
        let (tangent, sign) = decoded_tangent(encode_tangent(direction, flipped));
        worst_tangent = worst_tangent.max(degrees(tangent, direction));
        assert_eq!(sign, flipped);
    }
    assert!(
        worst_normal < 0.01 && worst_tangent < 0.01,
        "{worst_normal} and {worst_tangent} degrees"
    );
}

#[test]
fn colors_of_any_format() {
    use VertexAttributeValues as V;
    let half = |value: f32| if value == 0.5 { 0x3800_u16 } else { 0x3c00 };
    let cases = [
        (V::Unorm8x4(vec![[255, 128, 0, 64]; 3]), [1.0, 0.502, 0.0, 64.0]),
        (V::Unorm8x4Bgra(vec![[255, 128, 0, 64]; 3]), [0.0, 0.502, 1.0, 64.0]),
        (V::Unorm16x4(vec![[65535, 32896, 0, 16448]; 3]), [1.0, 0.502, 0.0, 64.0]),
        (V::Unorm16x2(vec![[65535, 0]; 3]), [1.0, 0.0, 0.0, 255.0]),
        (V::Snorm16x4(vec![[-32768, 32767, 16384, 0]; 3]), [0.0, 1.0, 0.5, 0.0]),
        (V::Snorm8x4(vec![[-128, 127, 0, 64]; 3]), [0.0, 1.0, 0.0, 129.0]),
        (
            V::Float16x4(bytemuck::cast_vec(vec![[half(0.5), half(1.0), 0, half(1.0)]; 3])),
            [0.5, 1.0, 0.0, 255.0],
        ),
        // Bright colours stay bright, and dark ones dark.
        (V::Float32x4(vec![[1e-6, 20.0, -1.0, 2.0]; 3]), [1e-6, 20.0, 0.0, 255.0]),
        (V::Float32x3(vec![[1e9, 0.002, 3e-5]; 3]), [65504.0, 0.002, 3e-5, 255.0]),
        (V::Float64x3(vec![[0.5, 1.0, 0.0]; 3]), [0.5, 1.0, 0.0, 255.0]),
        (V::Unorm10_10_10_2(vec![1023 | (2 << 30); 3]), [1.0, 0.0, 0.0, 170.0]),
        (V::Uint8(vec![1; 3]), [1.0, 0.0, 0.0, 255.0]),
        (V::Sint32x2(vec![[-4, 1]; 3]), [0.0, 1.0, 0.0, 255.0]),
    ];
    for (values, expected) in cases {
        let expected: [f32; 4] = expected;
        let packed = pack_mesh(&with(triangle_mesh(line(3)), Mesh::ATTRIBUTE_COLOR, values.clone())).unwrap();
        for color in colors(&packed) {
            for (actual, expected) in color.into_iter().zip(expected) {
                let room = (expected * 5e-4).max(6e-8);
                assert!((actual - expected).abs() <= room, "{values:?}: {color:?}");
            }
        }
    }
}

#[test]
fn compressed_meshes_decode_like_the_source() {
    let directions = fibonacci_sphere(300);
    let array = |f: &dyn Fn(&Vec3) -> Vec3| directions.iter().map(|d| f(d).to_array()).collect::<Vec<_>>();
    let tangents: Vec<[f32; 4]> = directions
        .iter()
        .enumerate()
        .map(|(i, d)| d.zxy().extend(if i % 2 == 0 { 1.0 } else { -1.0 }).to_array())
        .collect();
    let uvs = |offset: f32| directions.iter().map(|d| [d.x * 3.0 + offset, d.y]).collect::<Vec<_>>();
    let mesh = triangle_mesh(array(&|d| *d * Vec3::new(2.0, 3.0, 0.0) + Vec3::splat(5.0)))
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, array(&|d| *d))
        .with_inserted_attribute(Mesh::ATTRIBUTE_TANGENT, tangents)
        .with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, uvs(0.0))
        .with_inserted_attribute(Mesh::ATTRIBUTE_UV_1, uvs(10.0));
    let source = pack_mesh(&mesh).unwrap();
    let mut compressed = mesh.clone();
    compressed
        .compress_positions()
        .unwrap()
        .compress_normals()
        .unwrap()
        .compress_tangents()
        .unwrap();
    compressed.compress_uv0().unwrap().compress_uv1().unwrap();
    let packed = pack_mesh(&compressed).unwrap();
    assert_eq!(packed.offsets, source.offsets);
    assert!(packed.defects.is_empty());
    for (a, b) in packed.positions().iter().zip(source.positions()) {
        assert!(Vec3::from(*a).distance(Vec3::from(*b)) < 2e-4, "{a:?} {b:?}");
    }
    for offset in [source.offsets.uv0, source.offsets.uv1] {
        let pairs = floats(&packed, offset).into_iter().zip(floats(&source, offset));
        assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-4));
    }
    for (a, b) in words(&packed, source.offsets.normals, 1)
        .iter()
        .zip(words(&source, source.offsets.normals, 1))
    {
        assert!(degrees(decoded_normal(*a), decoded_normal(*b)) < 0.02);
    }
    for (a, b) in words(&packed, source.offsets.tangents, 1)
        .iter()
        .zip(words(&source, source.offsets.tangents, 1))
    {
        let ((a, a_sign), (b, b_sign)) = (decoded_tangent(*a), decoded_tangent(*b));
        assert!(degrees(a, b) < 0.02 && a_sign == b_sign);
    }
    // Bevy drops the box of compressed positions when it takes the data out of the main world.
    let mut lost = compressed.clone();
    lost.final_aabb = None;
    assert!(matches!(pack_mesh(&lost), Err(GeometryError::MissingAabb)));
    lost.final_aabb = Some(Aabb3d {
        min: Vec3A::NAN,
        max: Vec3A::INFINITY,
    });
    assert_eq!(pack_mesh(&lost).unwrap().triangle_count, 0);
}

#[test]
fn joints_and_morph_targets_are_packed() {
    use bevy::mesh::{VertexAttributeValues, morph::MorphAttributes};
    let joints = VertexAttributeValues::Uint16x4(vec![[0, 1, 2, 3], [7, 0, 0, 0], [2, 7, 0, 0]]);
    let weights = vec![[0.5, 0.5, 0.0, 0.0], [f32::NAN, 0.0, 0.0, 0.0], [0.25, 0.75, 0.0, 0.0]];
    let target = |x: f32| MorphAttributes::new(Vec3::X * x, Vec3::Y, Vec3::Z);
    let mesh = triangle_mesh(line(3))
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, vec![[0.0, 0.0, 1.0]; 3])
        .with_inserted_attribute(Mesh::ATTRIBUTE_JOINT_INDEX, joints)
        .with_inserted_attribute(Mesh::ATTRIBUTE_JOINT_WEIGHT, weights)
        .with_morph_targets([1.0, 2.0, 3.0, -1.0, f32::INFINITY, 0.5].map(target).to_vec());
    let packed = pack_mesh(&mesh).unwrap();
    assert_eq!(packed.defects.replaced_values, 2, "a weight and a difference");
    let at = packed.offsets.joints as usize;
    let half = 0.5_f32.to_bits();
    assert_eq!(packed.words[at..at + 6], [1 << 16, 2 | 3 << 16, half, half, 0, 0]);
    assert_eq!(
        packed.words[at + 6..at + 9],
        [0, 0, 1.0_f32.to_bits()],
        "it follows the first joint"
    );
    let morphs = packed.words[packed.offsets.morphs as usize..][..8].iter();
    let morphs: Vec<f32> = morphs.map(|word| f32::from_bits(*word)).collect();
    assert_eq!(morphs, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 2.0, 0.0]);
    assert_eq!(packed.words[2], 2);
    assert_eq!(packed.words[10..12], [packed.offsets.joints, packed.offsets.morphs]);
    let deformation = packed.deformation.as_ref().unwrap();
    let vertex = |i: usize| Vec3::from(packed.positions()[i]);
    let around = |a: Vec3, b: Vec3| Bounds {
        min: a.min(b),
        max: a.max(b),
    };
    let expected = [
        (0, around(vertex(0), vertex(1))),
        (1, around(vertex(0), vertex(0))),
        (2, around(vertex(2), vertex(2))),
        (7, around(vertex(2), vertex(2))),
    ];
    assert_eq!(deformation.joints, expected);
    assert_eq!(deformation.targets[0], around(Vec3::X, Vec3::X * 3.0));
    assert_eq!(deformation.targets[1], around(-Vec3::X, Vec3::X * 0.5));
}

/// Bit patterns, to include NaN, infinities and denormals, and ordinary numbers.
fn junk_float() -> impl Strategy<Value = f32> {
    prop_oneof![any::<u32>().prop_map(f32::from_bits), -10.0_f32..10.0, Just(0.0)]
}

fn junk_values() -> impl Strategy<Value = VertexAttributeValues> {
    use VertexAttributeValues as V;
    let floats = || prop::collection::vec(junk_float(), 0..40);
    prop_oneof![
        floats().prop_map(|v| V::Float32x3(v.as_chunks().0.to_vec())),
        floats().prop_map(|v| V::Float32x2(v.as_chunks().0.to_vec())),
        floats().prop_map(|v| V::Float32x4(v.as_chunks().0.to_vec())),
        floats().prop_map(V::Float32),
        floats().prop_map(|v| V::Float64(v.into_iter().map(|x| f64::from(x) * 1e300).collect())),
        prop::collection::vec(any::<[i16; 2]>(), 0..20).prop_map(V::Snorm16x2),
        prop::collection::vec(any::<[i16; 4]>(), 0..20).prop_map(V::Snorm16x4),
        prop::collection::vec(any::<[u16; 2]>(), 0..20).prop_map(V::Unorm16x2),
        prop::collection::vec(any::<[u16; 4]>(), 0..20).prop_map(|v| V::Float16x4(bytemuck::cast_vec(v))),
        prop::collection::vec(any::<u32>(), 0..20).prop_map(V::Unorm10_10_10_2),
    ]
}

fn junk_indices() -> impl Strategy<Value = Option<Indices>> {
    let small = || prop::collection::vec(prop_oneof![0_u16..20, any::<u16>(), Just(u16::MAX)], 0..60);
    prop_oneof![
        Just(None),
        small().prop_map(|indices| Some(Indices::U16(indices))),
        prop::collection::vec(prop_oneof![0_u32..20, any::<u32>(), Just(u32::MAX)], 0..60)
            .prop_map(|indices| Some(Indices::U32(indices))),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]
    #[test]
    fn junk_never_panics(
        strip in any::<bool>(),
        compress in any::<[bool; 5]>(),
        attributes in prop::collection::vec((0_usize..6, junk_values()), 0..7),
        indices in junk_indices(),
    ) {
        let topology = if strip { PrimitiveTopology::TriangleStrip } else { PrimitiveTopology::TriangleList };
        let mut mesh = mesh_of(topology, line(12)).with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, line(12));
        let slots = [
            Mesh::ATTRIBUTE_POSITION, Mesh::ATTRIBUTE_NORMAL, Mesh::ATTRIBUTE_TANGENT,
            Mesh::ATTRIBUTE_UV_0, Mesh::ATTRIBUTE_UV_1, Mesh::ATTRIBUTE_COLOR,
        ];
        for (slot, values) in attributes {
            mesh = with(mesh, slots[slot], values);
        }
        let _ = compress[0] && mesh.compress_positions().is_ok();
        let _ = compress[1] && mesh.compress_normals().is_ok();
        let _ = compress[2] && mesh.compress_tangents().is_ok();
        let _ = compress[3] && mesh.compress_uv0().is_ok();
        let _ = compress[4] && mesh.compress_uv1().is_ok();
        if let Some(indices) = indices {
            mesh.insert_indices(indices);
        }
        let packed = pack_mesh(&mesh).unwrap();
        prop_assert!(packed.positions().as_flattened().iter().all(|x| x.abs() <= MAX_COORDINATE));
        prop_assert!(packed.indices().iter().all(|index| *index < packed.vertex_count));
        prop_assert_eq!(packed.positions().len(), packed.vertex_count as usize);
        prop_assert_eq!(packed.triangles().len(), packed.triangle_count as usize);
        prop_assert!(packed.bounds.min.is_finite() && packed.bounds.max.is_finite());
        for offset in [packed.offsets.uv0, packed.offsets.uv1] {
            prop_assert!(offset == 0 || floats(&packed, offset).iter().all(|x| x.is_finite()));
        }
    }
}
