// Linear equations of a symmetric matrix without negative eigenvalues.

/**
 * Return the x of (matrix + added · 1) x = wanted, by Cholesky's method; null if there is none.
 *
 * `matrix` (N, N) is given row by row; its lower half is read.
 */
export function solveDamped(matrix: ArrayLike<number>, added: number, wanted: ArrayLike<number>): Float64Array | null {
  const size = wanted.length;
  const lower = new Float64Array(size * size);
  for (let i = 0; i < size; i++) {
    for (let j = 0; j <= i; j++) {
      let sum = matrix[i * size + j]! + (i === j ? added : 0);
      for (let k = 0; k < j; k++) {
        sum -= lower[i * size + k]! * lower[j * size + k]!;
      }
      if (i > j) {
        lower[i * size + j] = sum / lower[j * size + j]!;
      } else if (sum > 0) {
        lower[i * size + i] = Math.sqrt(sum);
      } else {
        return null;
      }
    }
  }
  const solution = Float64Array.from(wanted);
  for (let i = 0; i < size; i++) {
    for (let k = 0; k < i; k++) {
      solution[i]! -= lower[i * size + k]! * solution[k]!;
    }
    solution[i]! /= lower[i * size + i]!;
  }
  for (let i = size - 1; i >= 0; i--) {
    for (let k = i + 1; k < size; k++) {
      solution[i]! -= lower[k * size + i]! * solution[k]!;
    }
    solution[i]! /= lower[i * size + i]!;
  }
  return solution;
}
