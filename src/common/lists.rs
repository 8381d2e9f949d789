//! Words of the buffers `indirect_args` and `counters`, and the limit of a dispatch. `lists.wesl` has the same for shaders.

/// Largest number of workgroups in the x direction of a dispatch.
pub(crate) const MAX_WORKGROUPS: u32 = 65535;

/// Words of the buffer `indirect_args`: four dispatches of three words each, the lengths of three lists, and a dispatch over two of them
/// with the number of its workgroups.
pub(crate) const INDIRECT_ARG_WORDS: u64 = 19;
/// First word of the dispatch over the ray list.
pub(crate) const RAY_DISPATCH: u64 = 0;
/// First word of the dispatch over the mirror ray list.
pub(crate) const MIRROR_RAY_DISPATCH: u64 = 3;
/// First word of the dispatch over the tile list, one workgroup for each 8x8 pixels.
pub(crate) const TILE_DISPATCH: u64 = 6;
/// First word of the dispatch over the tile list, one workgroup for each 16x16 pixels.
pub(crate) const WIDE_TILE_DISPATCH: u64 = 9;
/// Word with the length of the ray list.
pub(crate) const RAY_COUNT: u64 = 12;
/// Word with the length of the mirror ray list.
pub(crate) const MIRROR_RAY_COUNT: u64 = 13;
/// Word with the length of the tile list.
pub(crate) const TILE_COUNT: u64 = 14;
/// First word of the dispatch over both lists of rays.
pub(crate) const ALL_RAYS_DISPATCH: u64 = 15;

/// Words of the buffer `counters`.
pub(crate) const COUNTER_WORDS: u64 = 8;
/// Word with the number of rays that hit something.
pub(crate) const HIT_COUNT: u64 = 0;
/// Word with the number of rays that hit a recent change.
pub(crate) const CHANGE_COUNT: u64 = 1;

/// Byte offset of a word.
pub(crate) const fn word_offset(word: u64) -> u64 {
    4 * word
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_those_of_the_shader() {
        let shader = include_str!("lists.wesl");
        for (name, word) in [
            ("MAX_WORKGROUPS", u64::from(MAX_WORKGROUPS)),
            ("INDIRECT_ARG_WORDS", INDIRECT_ARG_WORDS),
            ("RAY_DISPATCH", RAY_DISPATCH),
            ("MIRROR_RAY_DISPATCH", MIRROR_RAY_DISPATCH),
            ("TILE_DISPATCH", TILE_DISPATCH),
            ("WIDE_TILE_DISPATCH", WIDE_TILE_DISPATCH),
            ("RAY_COUNT", RAY_COUNT),
            ("MIRROR_RAY_COUNT", MIRROR_RAY_COUNT),
            ("TILE_COUNT", TILE_COUNT),
            ("ALL_RAYS_DISPATCH", ALL_RAYS_DISPATCH),
            ("COUNTER_WORDS", COUNTER_WORDS),
            ("HIT_COUNT", HIT_COUNT),
            ("CHANGE_COUNT", CHANGE_COUNT),
        ] {
            let line = format!("const {name}: u32 = {word}u;");
            assert!(shader.contains(&line), "{line}");
        }
    }
}
