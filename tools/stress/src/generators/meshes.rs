//! Meshes that no modelling program writes, but broken files contain.

use super::Builder;
use bevy::{
    asset::RenderAssetUsages,
    mesh::{Indices, PrimitiveTopology, VertexAttributeValues},
    prelude::*,
};
use clap::ValueEnum;
use glint_scenes::Random;
use serde::{Deserialize, Serialize};

/// Meshes that no modelling program writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum MeshKind {
    /// Some positions are NaN.
    NanPositions,
    /// Some positions are infinite.
    InfinitePositions,
    /// All positions are NaN.
    OnlyNanPositions,
    /// Coordinates of about 1e-6.
    TinyCoordinates,
    /// Coordinates of about 1e6.
    HugeCoordinates,
    /// Coordinates with squares that overflow.
    OverflowingCoordinates,
    /// Triangles with three equal corners.
    Points,
    /// Triangles with corners on a line.
    ZeroArea,
    /// Triangles that are long and extremely thin.
    Needles,
    /// Many triangles in one place.
    Coplanar,
    /// Normals that are NaN.
    NanNormals,
    /// Normals that are infinite.
    InfiniteNormals,
    /// Normals of length zero.
    ZeroNormals,
    /// Random normals.
    RandomNormals,
    /// UVs that are NaN.
    NanUvs,
    /// UVs of about 1e30.
    HugeUvs,
    /// Tangents that are NaN.
    NanTangents,
    /// Vertex colours that are NaN, infinite and negative.
    OddColors,
    /// No vertices.
    Empty,
    /// A single index.
    OneIndex,
    /// One vertex.
    OneVertex,
    /// Two vertices and two indices.
    TwoVertices,
    /// Indices beyond the last vertex.
    OutOfRangeIndices,
    /// A number of indices that isn't a multiple of three.
    RaggedIndices,
    /// A line list.
    Lines,
    /// A point list.
    PointList,
    /// A strip with restarts.
    Strip,
    /// Attributes with different numbers of values.
    UnevenAttributes,
    /// Only positions.
    BarePositions,
    /// Vertices that exist in the render world only.
    RenderWorldOnly,
    /// More triangles than pixels.
    Dense,
}

/// Adds an object of such a mesh.
pub fn add(kind: MeshKind, builder: &mut Builder) {
    let mesh = mesh(kind, &mut builder.random);
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

/// The cube with other normals.
fn with_normals(normal: impl FnMut() -> [f32; 3]) -> Mesh {
    let mut normals = Vec::new();
    let mesh = cube();
    normals.resize_with(mesh.count_vertices(), normal);
    mesh.with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, normals)
}

fn mesh(kind: MeshKind, random: &mut Random) -> Mesh {
    const NAN: f32 = f32::NAN;
    const INFINITY: f32 = f32::INFINITY;
    let axis = random.below(3);
    let count = cube().count_vertices();
    match kind {
        MeshKind::NanPositions => moved(|index, position| {
            if index % 5 == 0 {
                position[axis] = NAN;
            }
        }),
        MeshKind::InfinitePositions => moved(|index, position| {
            if index % 5 == 0 {
                position[axis] = if index % 2 == 0 { INFINITY } else { -INFINITY };
            }
        }),
        MeshKind::OnlyNanPositions => moved(|_, position| *position = [NAN; 3]),
        MeshKind::TinyCoordinates => moved(|_, position| *position = position.map(|x| x * 1e-6)),
        MeshKind::HugeCoordinates => moved(|_, position| *position = position.map(|x| x * 1e6)),
        MeshKind::OverflowingCoordinates => moved(|_, position| *position = position.map(|x| x * 1e30)),
        MeshKind::Points => soup(vec![[0.1, 0.2, 0.3]; 12]),
        MeshKind::ZeroArea => soup((0..30).map(|i| [0.05 * i as f32, 0.0, 0.0]).collect()),
        MeshKind::Needles => soup(needles(random)),
        MeshKind::Coplanar => {
            let corners = [[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.0, 0.5, 0.0]];
            soup(corners.into_iter().cycle().take(3 * 64).collect())
        }
        MeshKind::NanNormals => with_normals(|| [NAN; 3]),
        MeshKind::InfiniteNormals => with_normals(|| [INFINITY, -INFINITY, 1.0]),
        MeshKind::ZeroNormals => with_normals(|| [0.0; 3]),
        MeshKind::RandomNormals => with_normals(|| core::array::from_fn(|_| random.range(-1.0, 1.0))),
        MeshKind::NanUvs => cube().with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, vec![[NAN, INFINITY]; count]),
        MeshKind::HugeUvs => cube().with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, vec![[1e30, -1e30]; count]),
        MeshKind::NanTangents => cube().with_inserted_attribute(Mesh::ATTRIBUTE_TANGENT, vec![[NAN; 4]; count]),
        MeshKind::OddColors => {
            let colors = [[NAN; 4], [INFINITY, -1.0, 0.5, 1.0], [7.0, 0.5, 0.0, -1.0]];
            let colors: Vec<[f32; 4]> = colors.into_iter().cycle().take(count).collect();
            cube().with_inserted_attribute(Mesh::ATTRIBUTE_COLOR, colors)
        }
        MeshKind::Empty => soup(Vec::new()),
        MeshKind::OneIndex => cube().with_inserted_indices(Indices::U32(vec![0])),
        MeshKind::OneVertex => soup(vec![[0.0; 3]]),
        MeshKind::TwoVertices => soup(vec![[0.0; 3], [1.0; 3]]).with_inserted_indices(Indices::U32(vec![0, 1])),
        MeshKind::OutOfRangeIndices => {
            let indices = vec![0, 1, 2, 3, 4, 9_999_999, u32::MAX, 0, 1, 2, u32::MAX - 1, 5];
            cube().with_inserted_indices(Indices::U32(indices))
        }
        MeshKind::RaggedIndices => cube().with_inserted_indices(Indices::U16(vec![0, 1, 2, 3, 4])),
        MeshKind::Lines => other_topology(PrimitiveTopology::LineList),
        MeshKind::PointList => other_topology(PrimitiveTopology::PointList),
        MeshKind::Strip => {
            let indices = vec![0, 1, 2, 3, u16::MAX, 4, 5, 6, u16::MAX, u16::MAX, 7];
            other_topology(PrimitiveTopology::TriangleStrip).with_inserted_indices(Indices::U16(indices))
        }
        MeshKind::UnevenAttributes => {
            let uvs = vec![[0.5, 0.5]; count / 2];
            cube().with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, uvs)
        }
        MeshKind::BarePositions => cube()
            .with_removed_attribute(Mesh::ATTRIBUTE_NORMAL)
            .with_removed_attribute(Mesh::ATTRIBUTE_UV_0),
        MeshKind::RenderWorldOnly => {
            let mut mesh = cube();
            mesh.asset_usage = RenderAssetUsages::RENDER_WORLD;
            mesh
        }
        MeshKind::Dense => Sphere::new(0.4).mesh().uv(160, 100),
    }
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
