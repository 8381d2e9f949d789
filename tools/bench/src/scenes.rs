//! Scenes with both tracers.

use crate::{
    arguments::Plan,
    measure::{Bench, Tables, tracer_word},
    table::{Csv, Table},
};

/// Measures and prints.
///
/// # Errors
///
/// If rays can't be traced, or a scene doesn't become ready.
pub fn measure(plan: &Plan, csv: &mut Csv) -> Result<(), String> {
    let mut tables = tables();
    let mut memory_known = false;
    for scene in &plan.subjects {
        for &choice in &plan.tracers {
            let mut bench = Bench::new(scene, choice, plan)?;
            let report = bench.report();
            let Some(tracer) = tracer_word(&report, choice)? else {
                println!("{scene}: {}.", report.reasons.join(". "));
                continue;
            };
            for (index, technique) in plan.techniques.iter().enumerate() {
                let word = technique.to_string();
                bench.set_technique(technique);
                let report = bench.wait_for_scene()?;
                bench.measure(plan.frames)?;
                if index == 0 {
                    bench.describe(scene, tracer, &report, &mut tables.scenes, csv);
                    bench.kernels(scene, tracer, &mut tables.kernels, csv);
                }
                bench.passes(scene, tracer, &word, &mut tables.passes, csv);
                if !memory_known {
                    bench.memory(scene, &word, &mut tables.memory, csv);
                }
            }
            for folder in &plan.shaders {
                let replaced = bench.replace_shaders(folder)?;
                let version = folder.file_name().unwrap_or(folder.as_os_str()).to_string_lossy();
                for technique in &plan.techniques {
                    bench.set_technique(technique);
                    if let Err(reason) = bench.wait_for_scene() {
                        println!("{}: {reason}", folder.display());
                        break;
                    }
                    bench.measure(plan.frames)?;
                    let word = format!("{technique}, {version}");
                    bench.passes(scene, tracer, &word, &mut tables.passes, csv);
                }
                bench.restore_shaders(replaced);
            }
            memory_known = true;
        }
    }
    for table in [&tables.scenes, &tables.kernels, &tables.passes, &tables.memory] {
        table.print();
    }
    Ok(())
}

fn tables() -> Tables {
    Tables {
        scenes: Table::new(
            "Scenes (build times of the CPU, of meshes summed over threads; memory without what a driver keeps for ray queries)",
            "scene | tracer | mesh triangles | placed triangles | instances | meshes ms | top level ms | MiB",
        ),
        kernels: Table::new(
            "Closest hits alone: one ray per pixel from the camera; specular reflections at half resolution, and the same \
             without alpha tests",
            "scene | tracer | kernel | rays | hits | median ms | p95 ms | Mrays/s",
        ),
        passes: Table::new(
            "Passes (median ms of the GPU; the total without timers between them) and rays of a frame, roughness cut-off 1",
            "scene | tracer | technique | rate | trace | reconstruct | temporal | denoise | composite | total | layer find | \
             layer rate | layer trace | layer reconstruct | layer temporal | layer denoise | layer composite | layer total | \
             rays | mirror rays | hits",
        ),
        memory: Table::new(
            "Memory of a camera (B, and B per pixel of the view)",
            "technique | part | B | B/pixel",
        ),
    }
}
