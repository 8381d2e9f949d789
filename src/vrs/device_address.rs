//! Makes a SPIR-V module access its acceleration structure by device address instead of by descriptor.
//!
//! wgpu doesn't expose handles of its acceleration structures, only their addresses. The module's binding becomes a push
//! constant of two words. Each load of it becomes a load of the address, which `OpConvertUToAccelerationStructureKHR`
//! converts to an acceleration structure.

const HEADER_WORDS: usize = 5;
/// Index of the first unused id in the header.
const BOUND: usize = 3;

const OP_TYPE_INT: u32 = 21;
const OP_TYPE_VECTOR: u32 = 23;
const OP_TYPE_STRUCT: u32 = 30;
const OP_TYPE_POINTER: u32 = 32;
const OP_FUNCTION: u32 = 54;
const OP_VARIABLE: u32 = 59;
const OP_LOAD: u32 = 61;
const OP_DECORATE: u32 = 71;
const OP_MEMBER_DECORATE: u32 = 72;
const OP_COMPOSITE_EXTRACT: u32 = 81;
const OP_CONVERT_U_TO_ACCELERATION_STRUCTURE: u32 = 4447;
const OP_TYPE_ACCELERATION_STRUCTURE: u32 = 5341;

const DECORATION_BLOCK: u32 = 2;
const DECORATION_OFFSET: u32 = 35;
const STORAGE_UNIFORM_CONSTANT: u32 = 0;
const STORAGE_PUSH_CONSTANT: u32 = 9;

/// Bytes of the push constant, from offset 0: the address, low word first.
pub(super) const ADDRESS_BYTES: u32 = 8;

/// An instruction with its operands.
pub(super) type Instruction<'a> = (u32, &'a [u32]);

pub(super) fn instructions(module: &[u32]) -> Result<Vec<Instruction<'_>>, String> {
    let mut list = Vec::new();
    let mut rest = module.get(HEADER_WORDS..).ok_or(BROKEN)?;
    while let Some(&first) = rest.first() {
        let count = (first >> 16) as usize;
        if count == 0 || count > rest.len() {
            return Err(BROKEN.into());
        }
        list.push((first & 0xffff, &rest[1..count]));
        rest = &rest[count..];
    }
    Ok(list)
}

const BROKEN: &str = "a SPIR-V module is broken";

fn push(module: &mut Vec<u32>, op: u32, operands: &[u32]) {
    module.push(((operands.len() as u32 + 1) << 16) | op);
    module.extend_from_slice(operands);
}

/// Known ids of the module's types and variables.
#[derive(Default)]
struct Found {
    structure: Option<u32>,
    u32_type: Option<u32>,
    vec2_type: Option<u32>,
    pointers: Vec<u32>,
    variables: Vec<u32>,
}

impl Found {
    fn new(list: &[Instruction<'_>]) -> Self {
        let mut found = Self::default();
        for &(op, operands) in list {
            match (op, operands) {
                (OP_TYPE_ACCELERATION_STRUCTURE, &[id]) => found.structure = Some(id),
                (OP_TYPE_INT, &[id, 32, 0]) => found.u32_type = Some(id),
                (OP_TYPE_VECTOR, &[id, component, 2]) if Some(component) == found.u32_type => {
                    found.vec2_type = Some(id);
                }
                (OP_TYPE_POINTER, &[id, STORAGE_UNIFORM_CONSTANT, target]) if Some(target) == found.structure => {
                    found.pointers.push(id);
                }
                (OP_VARIABLE, &[kind, id, ..]) if found.pointers.contains(&kind) => found.variables.push(id),
                _ => {}
            }
        }
        found
    }
}

/// The module with its acceleration structure read by address; `None` if it has no acceleration structure.
pub(super) fn read_by_address(module: &[u32]) -> Result<Option<Vec<u32>>, String> {
    let list = instructions(module)?;
    let found = Found::new(&list);
    let (structure, variable) = match (found.structure, found.variables.as_slice()) {
        (_, []) => return Ok(None),
        (Some(structure), &[variable]) => (structure, variable),
        _ => return Err("the shader has more than one acceleration structure".into()),
    };

    let mut next = module[BOUND];
    let mut new_id = || {
        next += 1;
        next - 1
    };
    let u32_type = found.u32_type.unwrap_or_else(&mut new_id);
    let vec2_type = found.vec2_type.unwrap_or_else(&mut new_id);
    let (block, pointer) = (new_id(), new_id());

    let mut out = module[..HEADER_WORDS].to_vec();
    let mut declared = false;
    let mut decorated = false;
    for &(op, operands) in &list {
        match (op, operands) {
            (OP_DECORATE, &[target, ..]) if target == variable => {
                if !decorated {
                    decorated = true;
                    push(&mut out, OP_DECORATE, &[block, DECORATION_BLOCK]);
                    push(&mut out, OP_MEMBER_DECORATE, &[block, 0, DECORATION_OFFSET, 0]);
                }
            }
            // It is declared at the end, after the types that it now needs.
            (OP_VARIABLE, &[_, id, ..]) if id == variable => {}
            (OP_LOAD, &[_, result, source, ..]) if source == variable => {
                let (loaded, address) = (new_id(), new_id());
                push(&mut out, OP_LOAD, &[block, loaded, variable]);
                push(&mut out, OP_COMPOSITE_EXTRACT, &[vec2_type, address, loaded, 0]);
                push(
                    &mut out,
                    OP_CONVERT_U_TO_ACCELERATION_STRUCTURE,
                    &[structure, result, address],
                );
            }
            _ => {
                if op == OP_FUNCTION && !declared {
                    declared = true;
                    if found.u32_type.is_none() {
                        push(&mut out, OP_TYPE_INT, &[u32_type, 32, 0]);
                    }
                    if found.vec2_type.is_none() {
                        push(&mut out, OP_TYPE_VECTOR, &[vec2_type, u32_type, 2]);
                    }
                    push(&mut out, OP_TYPE_STRUCT, &[block, vec2_type]);
                    push(&mut out, OP_TYPE_POINTER, &[pointer, STORAGE_PUSH_CONSTANT, block]);
                    push(&mut out, OP_VARIABLE, &[pointer, variable, STORAGE_PUSH_CONSTANT]);
                }
                push(&mut out, op, operands);
            }
        }
    }
    if !decorated || !declared {
        return Err(BROKEN.into());
    }
    out[BOUND] = next;
    Ok(Some(out))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A function that loads the variable 5 of the type 1, after types without vectors.
    fn module() -> Vec<u32> {
        let mut module = vec![0x0723_0203, 0x0001_0500, 0, 20, 0];
        push(&mut module, OP_DECORATE, &[5, 34, 1]);
        push(&mut module, OP_DECORATE, &[5, 33, 5]);
        push(&mut module, OP_TYPE_ACCELERATION_STRUCTURE, &[1]);
        push(&mut module, OP_TYPE_INT, &[2, 32, 0]);
        push(&mut module, OP_TYPE_POINTER, &[4, STORAGE_UNIFORM_CONSTANT, 1]);
        push(&mut module, OP_VARIABLE, &[4, 5, STORAGE_UNIFORM_CONSTANT]);
        push(&mut module, OP_FUNCTION, &[6, 7, 0, 8]);
        push(&mut module, OP_LOAD, &[1, 9, 5]);
        module
    }

    #[test]
    fn the_binding_becomes_a_push_constant() {
        let patched = read_by_address(&module()).unwrap().unwrap();
        let list = instructions(&patched).unwrap();
        // 20: vector, 21: block, 22: pointer to it; 23 and 24 are loaded.
        let expected: [Instruction<'_>; 12] = [
            (OP_DECORATE, &[21, DECORATION_BLOCK]),
            (OP_MEMBER_DECORATE, &[21, 0, DECORATION_OFFSET, 0]),
            (OP_TYPE_ACCELERATION_STRUCTURE, &[1]),
            (OP_TYPE_INT, &[2, 32, 0]),
            (OP_TYPE_POINTER, &[4, STORAGE_UNIFORM_CONSTANT, 1]),
            (OP_TYPE_VECTOR, &[20, 2, 2]),
            (OP_TYPE_STRUCT, &[21, 20]),
            (OP_TYPE_POINTER, &[22, STORAGE_PUSH_CONSTANT, 21]),
            (OP_VARIABLE, &[22, 5, STORAGE_PUSH_CONSTANT]),
            (OP_FUNCTION, &[6, 7, 0, 8]),
            (OP_LOAD, &[21, 23, 5]),
            (OP_COMPOSITE_EXTRACT, &[20, 24, 23, 0]),
        ];
        assert_eq!(list[..12], expected);
        assert_eq!(list[12..], [(OP_CONVERT_U_TO_ACCELERATION_STRUCTURE, &[1, 9, 24][..])]);
        assert_eq!(patched[BOUND], 25);
    }

    #[test]
    fn modules_without_acceleration_structures_stay() {
        let mut module = vec![0x0723_0203, 0x0001_0500, 0, 20, 0];
        push(&mut module, OP_TYPE_INT, &[2, 32, 0]);
        assert_eq!(read_by_address(&module), Ok(None));
    }

    #[test]
    fn broken_modules_are_errors() {
        assert!(read_by_address(&[0; 4]).is_err());
        assert!(read_by_address(&[0; 6]).is_err());
        let mut cut = module();
        cut.pop();
        assert!(read_by_address(&cut).is_err());
    }
}
