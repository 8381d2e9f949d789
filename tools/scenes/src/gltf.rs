//! Small glTF files with embedded buffers, written from code, for tests of the loader's path.

use base64::{Engine, prelude::BASE64_STANDARD};
use gltf_json::{Root, accessor, buffer};
use serde_json::{Value, json};
use std::{
    fs, io,
    path::{Path, PathBuf},
};

/// Writes `triangle.gltf` (U16 indices, positions only) and `quads.gltf` (two instances of a quad, one mirrored by a negative
/// scale, with normals, UVs and vertex colours, an emissive material and an alpha-masked double-sided one) into a folder; returns
/// their paths.
pub fn write_test_assets(folder: &Path) -> io::Result<[PathBuf; 2]> {
    fs::create_dir_all(folder)?;
    let paths = [folder.join("triangle.gltf"), folder.join("quads.gltf")];
    fs::write(&paths[0], triangle()?)?;
    fs::write(&paths[1], quads()?)?;
    Ok(paths)
}

/// Data of an accessor, and their JSON description.
type Attribute = (Vec<u8>, Value);

fn floats(values: &[f32], kind: &str) -> Attribute {
    let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    let width = if kind == "VEC2" { 2 } else { 3 };
    let count = values.len() / width;
    (
        bytes,
        json!({ "componentType": accessor::FLOAT, "count": count, "type": kind }),
    )
}

/// Positions between (-0.5, 0, 0) and (0.5, 1, 0).
fn positions(values: &[f32]) -> Attribute {
    let (bytes, mut accessor) = floats(values, "VEC3");
    (accessor["min"], accessor["max"]) = (json!([-0.5, 0.0, 0.0]), json!([0.5, 1.0, 0.0]));
    (bytes, accessor)
}

fn indices(bytes: Vec<u8>, component: u32, count: u32) -> Attribute {
    (
        bytes,
        json!({ "componentType": component, "count": count, "type": "SCALAR" }),
    )
}

/// A document with accessors in this order, in one buffer.
fn document(mut content: Value, attributes: Vec<Attribute>) -> io::Result<String> {
    let (mut bytes, mut views, mut accessors) = (Vec::new(), Vec::new(), Vec::new());
    for (data, mut accessor) in attributes {
        let is_indices = accessor["type"] == "SCALAR";
        let target = if is_indices {
            buffer::ELEMENT_ARRAY_BUFFER
        } else {
            buffer::ARRAY_BUFFER
        };
        views.push(json!({ "buffer": 0, "byteOffset": bytes.len(), "byteLength": data.len(), "target": target }));
        accessor["bufferView"] = accessors.len().into();
        accessors.push(accessor);
        bytes.extend(data);
        bytes.resize(bytes.len().next_multiple_of(4), 0);
    }
    let uri = format!(
        "data:application/octet-stream;base64,{}",
        BASE64_STANDARD.encode(&bytes)
    );
    content["asset"] = json!({ "version": "2.0" });
    content["scene"] = 0.into();
    content["bufferViews"] = views.into();
    content["accessors"] = accessors.into();
    content["buffers"] = json!([{ "byteLength": bytes.len(), "uri": uri }]);
    let root: Root = serde_json::from_value(content)?;
    Ok(root.to_string_pretty()?)
}

fn triangle() -> io::Result<String> {
    let content = json!({
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "material": 0 }] }],
        "materials": [{ "pbrMetallicRoughness": {
            "baseColorFactor": [0.8, 0.3, 0.1, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.4,
        } }],
    });
    let corners = positions(&[-0.5, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0, 0.0]);
    let order = [0u16, 1, 2].map(u16::to_le_bytes).concat();
    document(content, vec![corners, indices(order, accessor::UNSIGNED_SHORT, 3)])
}

fn quads() -> io::Result<String> {
    let plain = json!({ "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2 });
    let colored = json!({ "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2, "COLOR_0": 3 });
    let content = json!({
        "scenes": [{ "nodes": [0, 1] }],
        "nodes": [
            { "name": "plain", "mesh": 0, "translation": [-0.7, 0.0, 0.0] },
            { "name": "mirrored", "mesh": 1, "translation": [0.7, 0.0, 0.0], "scale": [-1.0, 1.5, 1.0] },
        ],
        "meshes": [
            { "primitives": [{ "attributes": plain, "indices": 4, "material": 0 }] },
            { "primitives": [{ "attributes": colored, "indices": 4, "material": 1 }] },
        ],
        "materials": [
            {
                "pbrMetallicRoughness": {
                    "baseColorFactor": [0.1, 0.1, 0.1, 1.0], "metallicFactor": 1.0, "roughnessFactor": 0.1,
                },
                "emissiveFactor": [0.2, 0.6, 0.9],
            },
            {
                "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 0.7 },
                "alphaMode": "MASK", "alphaCutoff": 0.5, "doubleSided": true,
            },
        ],
    });
    let color = json!({ "componentType": accessor::UNSIGNED_BYTE, "normalized": true, "count": 4, "type": "VEC4" });
    let colors = [[255; 4], [255, 128, 128, 255], [128, 255, 128, 255], [128, 128, 255, 0]];
    let attributes = vec![
        positions(&[-0.5, 0.0, 0.0, 0.5, 0.0, 0.0, 0.5, 1.0, 0.0, -0.5, 1.0, 0.0]),
        floats(&[0.0, 0.0, 1.0].repeat(4), "VEC3"),
        floats(&[0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0], "VEC2"),
        (colors.concat(), color),
        indices(vec![0, 1, 2, 0, 2, 3], accessor::UNSIGNED_BYTE, 6),
    ];
    document(content, attributes)
}
