//! Small glTF files with embedded buffers, written from code, for tests of the loader's path.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

/// Writes `triangle.gltf` (U16 indices, positions only) and `quads.gltf` (two instances of a quad, one mirrored by a negative scale, with normals,
/// UVs and vertex colours, an emissive material and an alpha-masked double-sided one) into a folder; returns their paths.
pub fn write_test_assets(folder: &Path) -> io::Result<[PathBuf; 2]> {
    fs::create_dir_all(folder)?;
    let paths = [folder.join("triangle.gltf"), folder.join("quads.gltf")];
    fs::write(&paths[0], triangle())?;
    fs::write(&paths[1], quads())?;
    Ok(paths)
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn embedded(bytes: &[u8]) -> String {
    format!("data:application/octet-stream;base64,{}", base64(bytes))
}

fn triangle() -> String {
    let mut bytes = floats(&[-0.5, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0, 0.0]);
    bytes.extend([0u16, 1, 2].into_iter().flat_map(u16::to_le_bytes));
    format!(
        r#"{{
  "asset": {{ "version": "2.0" }},
  "scene": 0,
  "scenes": [{{ "nodes": [0] }}],
  "nodes": [{{ "mesh": 0 }}],
  "meshes": [{{ "primitives": [{{ "attributes": {{ "POSITION": 0 }}, "indices": 1, "material": 0 }}] }}],
  "materials": [{{ "pbrMetallicRoughness": {{ "baseColorFactor": [0.8, 0.3, 0.1, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.4 }} }}],
  "accessors": [
    {{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [-0.5, 0.0, 0.0], "max": [0.5, 1.0, 0.0] }},
    {{ "bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR" }}
  ],
  "bufferViews": [
    {{ "buffer": 0, "byteOffset": 0, "byteLength": 36, "target": 34962 }},
    {{ "buffer": 0, "byteOffset": 36, "byteLength": 6, "target": 34963 }}
  ],
  "buffers": [{{ "byteLength": {}, "uri": "{}" }}]
}}
"#,
        bytes.len(),
        embedded(&bytes)
    )
}

fn quads() -> String {
    let mut bytes = floats(&[-0.5, 0.0, 0.0, 0.5, 0.0, 0.0, 0.5, 1.0, 0.0, -0.5, 1.0, 0.0]);
    bytes.extend(floats(&[0.0, 0.0, 1.0].repeat(4)));
    bytes.extend(floats(&[0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]));
    bytes.extend(
        [
            [255, 255, 255, 255],
            [255, 128, 128, 255],
            [128, 255, 128, 255],
            [128, 128, 255, 0u8],
        ]
        .concat(),
    );
    bytes.extend([0u8, 1, 2, 0, 2, 3, 0, 0]);
    format!(
        r#"{{
  "asset": {{ "version": "2.0" }},
  "scene": 0,
  "scenes": [{{ "nodes": [0, 1] }}],
  "nodes": [
    {{ "name": "plain", "mesh": 0, "translation": [-0.7, 0.0, 0.0] }},
    {{ "name": "mirrored", "mesh": 1, "translation": [0.7, 0.0, 0.0], "scale": [-1.0, 1.5, 1.0] }}
  ],
  "meshes": [
    {{ "primitives": [{{ "attributes": {{ "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2 }}, "indices": 4, "material": 0 }}] }},
    {{ "primitives": [{{ "attributes": {{ "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2, "COLOR_0": 3 }}, "indices": 4, "material": 1 }}] }}
  ],
  "materials": [
    {{ "pbrMetallicRoughness": {{ "baseColorFactor": [0.1, 0.1, 0.1, 1.0], "metallicFactor": 1.0, "roughnessFactor": 0.1 }}, "emissiveFactor": [0.2, 0.6, 0.9] }},
    {{ "pbrMetallicRoughness": {{ "metallicFactor": 0.0, "roughnessFactor": 0.7 }}, "alphaMode": "MASK", "alphaCutoff": 0.5, "doubleSided": true }}
  ],
  "accessors": [
    {{ "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-0.5, 0.0, 0.0], "max": [0.5, 1.0, 0.0] }},
    {{ "bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC3" }},
    {{ "bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC2" }},
    {{ "bufferView": 3, "componentType": 5121, "normalized": true, "count": 4, "type": "VEC4" }},
    {{ "bufferView": 4, "componentType": 5121, "count": 6, "type": "SCALAR" }}
  ],
  "bufferViews": [
    {{ "buffer": 0, "byteOffset": 0, "byteLength": 48, "target": 34962 }},
    {{ "buffer": 0, "byteOffset": 48, "byteLength": 48, "target": 34962 }},
    {{ "buffer": 0, "byteOffset": 96, "byteLength": 32, "target": 34962 }},
    {{ "buffer": 0, "byteOffset": 128, "byteLength": 16, "target": 34962 }},
    {{ "buffer": 0, "byteOffset": 144, "byteLength": 6, "target": 34963 }}
  ],
  "buffers": [{{ "byteLength": {}, "uri": "{}" }}]
}}
"#,
        bytes.len(),
        embedded(&bytes)
    )
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let word = chunk.iter().fold(0u32, |word, &byte| word << 8 | u32::from(byte)) << (8 * (3 - chunk.len()));
        for digit in 0..4 {
            let used = digit <= chunk.len();
            text.push(if used {
                char::from(DIGITS[(word >> (18 - 6 * digit)) as usize & 63])
            } else {
                '='
            });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_pads() {
        assert_eq!([base64(b"M"), base64(b"Ma"), base64(b"Man")], ["TQ==", "TWE=", "TWFu"]);
    }
}
