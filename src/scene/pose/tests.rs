//! Poses and trees that the GPU makes against twins on the CPU.
