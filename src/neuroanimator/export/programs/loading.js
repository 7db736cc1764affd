async function instantiate(source) {
  if (source instanceof WebAssembly.Module) {
    return WebAssembly.instantiate(source, {});
  }
  let bytes = source;
  if (typeof source === "string" || source instanceof URL) {
    const response = await fetch(source);
    if (!response.ok) throw new Error(`${source}: ${response.status} ${response.statusText}`);
    bytes = await response.arrayBuffer();
  }
  return (await WebAssembly.instantiate(bytes, {})).instance;
}

function check(numbers, wanted, name) {
  if (numbers.length !== wanted) {
    throw new RangeError(`${name}: wanted ${wanted} numbers, got ${numbers.length}`);
  }
}
