// Named parts of states and controls, and their first entries.

/** Parts in order: name, size, unit. */
export type Layout = readonly (readonly [name: string, size: number, unit: string])[];

/** Return the size of a layout. */
export function sizeOf(layout: Layout): number {
  return layout.reduce((sum, [, size]) => sum + size, 0);
}

/** Return the first entry of each part. */
export function entriesOf(layout: Layout): Map<string, number> {
  const entries = new Map<string, number>();
  let entry = 0;
  for (const [name, size] of layout) {
    entries.set(name, entry);
    entry += size;
  }
  return entries;
}

/** Return a label for every number: the part's name, numbered or with an axis if it has several. */
export function labelsOf(layout: Layout): string[] {
  const labels: string[] = [];
  for (const [name, size, unit] of layout) {
    for (let i = 0; i < size; i++) {
      labels.push(size === 1 ? name : `${name} ${suffix(name, size, unit, i)}`);
    }
  }
  return labels;
}

function suffix(name: string, size: number, unit: string, i: number): string {
  const isVector = size === 3 && (unit === "m" || unit === "m/s" || name.endsWith("angular_velocity"));
  if (isVector) {
    return "xyz"[i]!;
  }
  return unit === "quaternion" ? "wxyz"[i]! : String(i + 1);
}
