// Judges WGSL by Tint: `node --input-type=module --eval SCRIPT -- PACKAGE FILE...`. The first line is about the package; then a line for
// each file: the file, `ok` or `failed`, and the reason, separated by tabs.
import { readFileSync } from 'node:fs';
import { pathToFileURL } from 'node:url';

const [folder, ...files] = process.argv.slice(1);
const { create, globals } = await import(pathToFileURL(`${folder}/index.js`));
Object.assign(globalThis, globals);
const { version } = JSON.parse(readFileSync(`${folder}/package.json`));
console.log(`Tint of webgpu ${version}`);

// Needs no GPU, and has the limits that every browser guarantees.
const gpu = create(['backend=null']);
const adapter = await gpu.requestAdapter();
const device = await adapter.requestDevice({ requiredFeatures: [...adapter.features] });
// Tracing passes need more, which `src/device/support.rs` and `src/trace/state.rs` check on the user's device.
const EXCUSED = /number of storage buffers \((9|10|11)\)/;

async function validate(action) {
  device.pushErrorScope('validation');
  const result = await action();
  const error = await device.popErrorScope();
  return [result, error?.message];
}

// Returns a reason, or nothing if the module and the pipelines of its compute passes are valid.
async function judge(code) {
  const [module] = await validate(() => device.createShaderModule({ code }));
  const { messages } = await module.getCompilationInfo();
  const first = messages.find((message) => message.type === 'error');
  if (first) return `line ${first.lineNum}: ${first.message}`;
  // Any number works for constants that get their value later.
  const names = [...code.matchAll(/^override (\w+)[^=]*;/gm)].map(([, name]) => [name, 4]);
  const constants = Object.fromEntries(names);
  for (const [, entryPoint] of code.matchAll(/@compute[^{]*?fn (\w+)/g)) {
    const compute = { module, entryPoint, constants };
    const [, error] = await validate(() => device.createComputePipeline({ layout: 'auto', compute }));
    if (error && !EXCUSED.test(error)) return `${entryPoint}: ${error}`;
  }
}

for (const file of files) {
  let reason;
  try {
    reason = await judge(readFileSync(file, 'utf8'));
  } catch (error) {
    reason = String(error);
  }
  console.log(reason ? `${file}\tfailed\t${reason.replace(/\s+/g, ' ')}` : `${file}\tok`);
}
device.destroy();
