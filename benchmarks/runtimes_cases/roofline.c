/* As many products of weights as a super step has, and nothing else: what a super step can take at least. */

/* `steps` times `blocks` of weights (8, LANES), each times one of `y` (LANES); the sums are left there. */
void products(const float *k, long blocks, long steps, float *y) {
    na_wide sums[8];
    for (int j = 0; j < 8; j++) NA_ZERO(sums[j]);
    for (long t = 0; t < steps; t++) {
        const na_wide *row = (const na_wide *)k;
        for (long q = 0; q < blocks; q++, row += 8)
            for (int j = 0; j < 8; j++) NA_MULTIPLY_ADD(sums[j], row[j], y[q % LANES]);
    }
    for (int j = 1; j < 8; j++) NA_ADD(sums[0], sums[j]);
    *(na_wide *)y = sums[0];
}

/* `steps` times `panels` of weights (LANES, LANES), each times x (LANES, LANES), for sixteen motions. */
void products_of_lanes(const float *k, const float *x, long panels, long steps, float *y) {
    for (long t = 0; t < steps; t++)
        for (long p = 0; p < panels; p++)
            na_lane_products(LANES, LANES, LANES, k + p * LANES * LANES, (const na_wide *)x, (na_wide *)y + p * LANES);
}
