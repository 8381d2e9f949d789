//! Meshes that no modelling program writes, but broken files contain.

use super::Builder;
use bevy::{
    asset::RenderAssetUsages,
    mesh::{Indices, MeshVertexAttribute, PrimitiveTopology, VertexAttributeValues},
    prelude::*,
};
use glint_scenes::Random;

const NAN: f32 = f32::NAN;
const INFINITY: f32 = f32::INFINITY;

kinds! {
    MeshKind, fn mesh(random: &mut Random, axis: usize) -> Mesh {
        // Some of the positions.
        NanPositions => some_moved(axis, |_| NAN),
        InfinitePositions => some_moved(axis, |index| if index % 2 == 0 { INFINITY } else { -INFINITY }),
        OnlyNanPositions => scaled(NAN),
        TinyCoordinates => scaled(1e-6),
        HugeCoordinates => scaled(1e6),
        // Their squares overflow.
        OverflowingCoordinates => scaled(1e30),
        // Triangles with three equal corners, and with corners on a line.
        Points => soup(vec![[0.1, 0.2, 0.3]; 12]),
        ZeroArea => soup((0..30).map(|i| [0.05 * i as f32, 0.0, 0.0]).collect()),
        Needles => soup(needles(random)),
        // Many triangles in one place.
        Coplanar => soup([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.0, 0.5, 0.0]].repeat(64)),
        NanNormals => with_normals(|| [NAN; 3]),
        InfiniteNormals => with_normals(|| [INFINITY, -INFINITY, 1.0]),
        ZeroNormals => with_normals(|| [0.0; 3]),
        RandomNormals => with_normals(|| core::array::from_fn(|_| random.range(-1.0, 1.0))),
        NanUvs => with(Mesh::ATTRIBUTE_UV_0, |count| vec![[NAN, INFINITY]; count]),
        HugeUvs => with(Mesh::ATTRIBUTE_UV_0, |count| vec![[1e30, -1e30]; count]),
        NanTangents => with(Mesh::ATTRIBUTE_TANGENT, |count| vec![[NAN; 4]; count]),
        OddColors => with(Mesh::ATTRIBUTE_COLOR, |count| {
            let colors = [[NAN; 4], [INFINITY, -1.0, 0.5, 1.0], [7.0, 0.5, 0.0, -1.0]];
            colors.into_iter().cycle().take(count).collect::<Vec<_>>()
        }),
        Empty => soup(Vec::new()),
        OneIndex => cube().with_inserted_indices(Indices::U32(vec![0])),
        OneVertex => soup(vec![[0.0; 3]]),
        TwoVertices => soup(vec![[0.0; 3], [1.0; 3]]).with_inserted_indices(Indices::U32(vec![0, 1])),
        OutOfRangeIndices => cube().with_inserted_indices(Indices::U32(vec![
            0, 1, 2, 3, 4, 9_999_999, u32::MAX, 0, 1, 2, u32::MAX - 1, 5,
        ])),
        // Not a multiple of three.
        RaggedIndices => cube().with_inserted_indices(Indices::U16(vec![0, 1, 2, 3, 4])),
        Lines => other_topology(PrimitiveTopology::LineList),
        PointList => other_topology(PrimitiveTopology::PointList),
        // With restarts.
        Strip => other_topology(PrimitiveTopology::TriangleStrip).with_inserted_indices(Indices::U16(vec![
            0, 1, 2, 3, u16::MAX, 4, 5, 6, u16::MAX, u16::MAX, 7,
        ])),
        UnevenAttributes => with(Mesh::ATTRIBUTE_UV_0, |count| vec![[0.5, 0.5]; count / 2]),
        BarePositions => cube()
            .with_removed_attribute(Mesh::ATTRIBUTE_NORMAL)
            .with_removed_attribute(Mesh::ATTRIBUTE_UV_0),
        RenderWorldOnly => in_render_world(cube()),
        // More triangles than pixels.
        Dense => Sphere::new(0.4).mesh().uv(160, 100),
    }
}

pub fn add(kind: MeshKind, builder: &mut Builder) {
    let random = &mut builder.scene.random;
    let axis = random.below(3);
    let mesh = mesh(kind, random, axis);
    let (material, transform) = (builder.plain(), builder.spot());
    builder.object(mesh, material, transform);
}

fn cube() -> Mesh {
    Cuboid::from_length(0.6).into()
}

/// Unindexed triangles.
fn soup(positions: Vec<[f32; 3]>) -> Mesh {
    let normals = vec![[0.0, 0.0, 1.0]; positions.len()];
    let uvs = vec![[0.0, 0.0]; positions.len()];
    Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions)
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, normals)
        .with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, uvs)
}

/// The cube with changed positions.
fn moved(mut change: impl FnMut(usize, &mut [f32; 3])) -> Mesh {
    let mut mesh = cube();
    if let Some(VertexAttributeValues::Float32x3(positions)) = mesh.attribute_mut(Mesh::ATTRIBUTE_POSITION) {
        for (index, position) in positions.iter_mut().enumerate() {
            change(index, position);
        }
    }
    mesh
}

/// The cube with another coordinate in every fifth position.
fn some_moved(axis: usize, coordinate: impl Fn(usize) -> f32) -> Mesh {
    moved(|index, position| {
        if index % 5 == 0 {
            position[axis] = coordinate(index);
        }
    })
}

fn scaled(scale: f32) -> Mesh {
    moved(|_, position| *position = position.map(|coordinate| coordinate * scale))
}

/// The cube with another attribute. `values` gets the number of its vertices.
fn with<V: Into<VertexAttributeValues>>(attribute: MeshVertexAttribute, values: impl FnOnce(usize) -> V) -> Mesh {
    let cube = cube();
    let values = values(cube.count_vertices());
    cube.with_inserted_attribute(attribute, values)
}

fn in_render_world(mut mesh: Mesh) -> Mesh {
    mesh.asset_usage = RenderAssetUsages::RENDER_WORLD;
    mesh
}

fn with_normals(mut normal: impl FnMut() -> [f32; 3]) -> Mesh {
    with(Mesh::ATTRIBUTE_NORMAL, |count| {
        (0..count).map(|_| normal()).collect::<Vec<_>>()
    })
}

fn needles(random: &mut Random) -> Vec<[f32; 3]> {
    (0..24)
        .flat_map(|_| {
            let (sin, cos) = ops::sin_cos(random.range(0.0, core::f32::consts::TAU));
            let width = random.pick(&[1e-3, 1e-6, 1e-12, 0.0]);
            let length = random.pick(&[0.5, 5.0, 500.0]);
            [
                [-length * cos, -length * sin, 0.0],
                [length * cos, length * sin, 0.0],
                [-width * sin, width * cos, 0.0],
            ]
        })
        .collect()
}

/// The vertices of the cube with another topology.
fn other_topology(topology: PrimitiveTopology) -> Mesh {
    let cube = cube();
    let mut other = Mesh::new(topology, RenderAssetUsages::default());
    for (attribute, values) in cube.attributes() {
        other.insert_attribute(*attribute, values.clone());
    }
    other
}
