/* Of residuals with the Jacobian `rows` (R, Z): `curvature` (Z, Z), rows' rows, and `slope` (Z,), rows' residuals. */
void quadratic_model(const float *rows, const float *residuals, long count, long size, float *curvature, float *slope) {
    memset(curvature, 0, size * size * sizeof(float));
    memset(slope, 0, size * sizeof(float));
    long r = 0;
    for (; r + 4 <= count; r += 4) {
        const float *a = rows + r * size, *b = a + size, *c = b + size, *d = c + size;
        for (long i = 0; i < size; i++) {
            float *NA_RESTRICT target = curvature + i * size;
            /* Rows of costs of single controls are nearly empty. */
            if (a[i] == 0 && b[i] == 0 && c[i] == 0 && d[i] == 0) continue;
            for (long j = 0; j < size; j++) target[j] += a[i] * a[j] + b[i] * b[j] + c[i] * c[j] + d[i] * d[j];
        }
        for (long i = 0; i < size; i++)
            slope[i] += a[i] * residuals[r] + b[i] * residuals[r + 1] + c[i] * residuals[r + 2] + d[i] * residuals[r + 3];
    }
    for (; r < count; r++) {
        const float *a = rows + r * size;
        for (long i = 0; i < size; i++) {
            if (a[i] == 0) continue;
            for (long j = 0; j < size; j++) curvature[i * size + j] += a[i] * a[j];
            slope[i] += a[i] * residuals[r];
        }
    }
}
