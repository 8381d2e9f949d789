//! A small glTF file that uses everything that loaders read, and ways to damage it.

use core::ops::Range;
use glint_scenes::Random;
use gltf_json::{
    Root,
    accessor::{FLOAT, UNSIGNED_SHORT},
    buffer::{ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER},
};
use serde_json::{Value, json};

/// Two by two texels.
const PNG: [u8; 77] = [
    0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44, 0x52, 0x00, 0x00, 0x00,
    0x02, 0x00, 0x00, 0x00, 0x02, 0x08, 0x06, 0x00, 0x00, 0x00, 0x72, 0xb6, 0x0d, 0x24, 0x00, 0x00, 0x00, 0x14, 0x49,
    0x44, 0x41, 0x54, 0x78, 0xda, 0x63, 0x38, 0x51, 0xa1, 0xf1, 0x5f, 0xa3, 0xe2, 0xc4, 0x7f, 0x06, 0x18, 0x03, 0x00,
    0x53, 0x64, 0x09, 0x9d, 0xaa, 0x0f, 0x56, 0xd5, 0x00, 0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60,
    0x82,
];

/// Numbers out of range, separated by spaces.
const NUMBERS: &str = "-1 0 1 3 255 65536 4294967295 18446744073709551615 1e38 -1e38 1e-40 0.5 1e999 5121";
/// Bits of values out of range: NaN, infinity, the largest and the smallest number, and indices that don't exist.
const WORDS: [u32; 6] = [0x7fc0_0000, 0x7f80_0000, 0x7f7f_ffff, 1, 0xffff_ffff, 0x0004_0004];

/// The contents of a binary glTF file.
#[derive(Clone, Debug, PartialEq)]
pub struct Parts {
    /// The document.
    pub json: String,
    /// Vertices, indices and an image.
    pub binary: Vec<u8>,
}

impl Default for Parts {
    fn default() -> Self {
        let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let data: [(Vec<u8>, Option<u32>); 5] = [
            (
                floats(&[-0.5, 0.0, 0.0, 0.5, 0.0, 0.0, 0.5, 1.0, 0.0, -0.5, 1.0, 0.0]),
                Some(ARRAY_BUFFER),
            ),
            (floats(&[0.0, 0.0, 1.0].repeat(4)), Some(ARRAY_BUFFER)),
            (floats(&[0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]), Some(ARRAY_BUFFER)),
            (
                [0u16, 1, 2, 0, 2, 3].map(u16::to_le_bytes).concat(),
                Some(ELEMENT_ARRAY_BUFFER),
            ),
            (PNG.to_vec(), None),
        ];
        let mut document = document();
        let (mut binary, mut views) = (Vec::new(), Vec::new());
        for (bytes, target) in data {
            let (offset, length) = (binary.len(), bytes.len());
            views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": length, "target": target }));
            binary.extend(bytes);
        }
        document["bufferViews"] = views.into();
        document["buffers"] = json!([{ "byteLength": binary.len() }]);
        let json = serde_json::from_value(document).and_then(|root: Root| root.to_string());
        Self {
            // A constant document, which the tests validate.
            json: json.expect("the document is valid"),
            binary,
        }
    }
}

/// Two meshes, textured and plain, a child, a lamp. Each accessor has the buffer view of the same index.
fn document() -> Value {
    json!({
        "asset": { "version": "2.0" },
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {
            "KHR_lights_punctual": { "lights": [{ "type": "point", "intensity": 40.0, "color": [1.0, 0.9, 0.8] }] },
        },
        "scene": 0,
        "scenes": [{ "nodes": [0, 1, 2] }],
        "nodes": [
            { "name": "plain", "mesh": 0, "translation": [-0.5, 0.1, 0.0], "scale": [1.0, 1.5, -1.0] },
            { "name": "turned", "mesh": 1, "rotation": [0.0, 0.6, 0.0, 0.8], "children": [3] },
            { "name": "lamp", "translation": [0.0, 2.0, 1.0], "extensions": { "KHR_lights_punctual": { "light": 0 } } },
            {
                "name": "child", "mesh": 0,
                "matrix": [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.4, 0.2, 0.0, 1.0],
            },
        ],
        "meshes": [
            { "primitives": [
                { "attributes": { "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2 }, "indices": 3, "material": 0 },
            ] },
            { "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 3, "material": 1 }] },
        ],
        "materials": [
            {
                "pbrMetallicRoughness": {
                    "baseColorTexture": { "index": 0 }, "metallicFactor": 1.0, "roughnessFactor": 0.1,
                },
                "emissiveFactor": [0.1, 0.2, 0.3],
            },
            {
                "pbrMetallicRoughness": {
                    "baseColorFactor": [0.8, 0.3, 0.2, 0.9], "metallicFactor": 0.0, "roughnessFactor": 0.6,
                },
                "alphaMode": "MASK", "alphaCutoff": 0.5, "doubleSided": true,
            },
        ],
        "textures": [{ "source": 0, "sampler": 0 }],
        "samplers": [{ "magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 33071 }],
        "images": [{ "bufferView": 4, "mimeType": "image/png" }],
        "accessors": [
            {
                "bufferView": 0, "componentType": FLOAT, "count": 4, "type": "VEC3",
                "min": [-0.5, 0.0, 0.0], "max": [0.5, 1.0, 0.0],
            },
            { "bufferView": 1, "componentType": FLOAT, "count": 4, "type": "VEC3" },
            { "bufferView": 2, "componentType": FLOAT, "count": 4, "type": "VEC2" },
            { "bufferView": 3, "componentType": UNSIGNED_SHORT, "count": 6, "type": "SCALAR" },
        ],
    })
}

impl Parts {
    /// Replaces some numbers of the document by others.
    pub fn wild_numbers(&mut self, random: &mut Random) {
        for _ in 0..1 + random.below(3) {
            let (_, numbers) = tokens(&self.json);
            let range = numbers[random.below(numbers.len())].clone();
            let wild: Vec<_> = NUMBERS.split(' ').collect();
            self.json.replace_range(range, random.pick(&wild));
        }
    }

    /// Renames some strings of the document, so that references are broken.
    pub fn lost_names(&mut self, random: &mut Random) {
        for _ in 0..1 + random.below(2) {
            let (strings, _) = tokens(&self.json);
            let range = strings[random.below(strings.len())].clone();
            self.json.replace_range(range, "lost");
        }
    }

    /// Replaces some words of the binary by others.
    pub fn wild_binary(&mut self, random: &mut Random) {
        for _ in 0..1 + random.below(12) {
            let word = random.below(self.binary.len() / 4) * 4;
            let wild = if random.chance(0.2) {
                random.bits()
            } else {
                random.pick(&WORDS)
            };
            self.binary[word..word + 4].copy_from_slice(&wild.to_le_bytes());
        }
    }

    /// The file: a header, then both parts, padded to multiples of four bytes.
    pub fn file(&self) -> Vec<u8> {
        let mut json = self.json.clone().into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let mut binary = self.binary.clone();
        binary.resize(binary.len().next_multiple_of(4), 0);
        let length = 12 + 8 + json.len() + 8 + binary.len();
        let mut file = Vec::with_capacity(length);
        file.extend(b"glTF");
        file.extend(2u32.to_le_bytes());
        file.extend((length as u32).to_le_bytes());
        for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &binary)] {
            file.extend((chunk.len() as u32).to_le_bytes());
            file.extend(kind);
            file.extend(chunk);
        }
        file
    }
}

/// Ranges of the contents of strings, and of numbers, in a JSON text without escapes.
fn tokens(json: &str) -> (Vec<Range<usize>>, Vec<Range<usize>>) {
    let range = |part: &str| {
        let start = part.as_ptr().addr() - json.as_ptr().addr();
        start..start + part.len()
    };
    let is_in_number = |letter: char| letter.is_ascii_digit() || "-+.eE".contains(letter);
    let is_number = |part: &&str| part.starts_with(|letter: char| letter.is_ascii_digit() || letter == '-');
    let (mut strings, mut numbers) = (Vec::new(), Vec::new());
    for (index, part) in json.split('"').enumerate() {
        if index % 2 == 1 {
            strings.push(range(part));
        } else {
            numbers.extend(part.split(|letter| !is_in_number(letter)).filter(is_number).map(range));
        }
    }
    (strings, numbers)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gltf_json::{Path, validation::Validate};

    #[test]
    fn the_file_is_whole() {
        let parts = Parts::default();
        let root = Root::from_str(&parts.json).unwrap();
        let mut errors = Vec::new();
        root.validate(&root, Path::new, &mut |path, error| errors.push((path(), error)));
        assert!(errors.is_empty(), "{errors:?}");
        // The types have dropped nothing.
        let lights = parts.json.matches("KHR_lights_punctual").count();
        assert_eq!((lights, root.nodes.len(), root.accessors.len()), (3, 4, 4));
        assert_eq!(parts.binary.len(), 217);
        let file = parts.file();
        assert_eq!(&file[..4], b"glTF");
        let length = u32::from_le_bytes([file[8], file[9], file[10], file[11]]);
        assert_eq!(length as usize, file.len());
        assert!(file.len().is_multiple_of(4) && !parts.json.contains('\\'));
    }

    #[test]
    fn tokens_are_found() {
        let json = r#"{ "a1": [-2.5e3, 7, true], "b": "x" }"#;
        let (strings, numbers) = tokens(json);
        let texts = |ranges: Vec<Range<usize>>| -> Vec<&str> { ranges.into_iter().map(|range| &json[range]).collect() };
        assert_eq!(texts(numbers), ["-2.5e3", "7"]);
        assert_eq!(texts(strings), ["a1", "b", "x"]);
    }

    #[test]
    fn damage_follows_from_the_seed() {
        let damaged = |seed: u64| {
            let mut parts = Parts::default();
            let mut random = Random::new(seed);
            parts.wild_numbers(&mut random);
            parts.lost_names(&mut random);
            parts.wild_binary(&mut random);
            parts
        };
        assert_eq!(damaged(3), damaged(3));
        for seed in 0..100 {
            assert_ne!(damaged(seed), Parts::default());
        }
    }
}
