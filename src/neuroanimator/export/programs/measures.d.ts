  readonly system: string;
  readonly dt: number;
  readonly substeps: number;
  readonly state: ReadonlyArray<readonly [name: string, size: number, unit: string]>;
  readonly control: ReadonlyArray<readonly [name: string, size: number, unit: string]>;
  readonly control_low: readonly number[];
  readonly control_high: readonly number[];
  readonly rest: readonly number[];
