/* Sixteen motions in parallel. Numbers are in the units of the emulator's state and control. */

#define SQUARE (LANES * LANES)
#define PADDED(count) (((count) + LANES - 1) / LANES * LANES)

/* The two halves of `from` (SQUARE), interleaved. */
static void riffle(const float *NA_RESTRICT from, float *NA_RESTRICT to) {
    for (int i = 0; i < SQUARE / 2; i++) {
        to[2 * i] = from[i];
        to[2 * i + 1] = from[SQUARE / 2 + i];
    }
}

/* Transposes `square` (LANES, LANES). A riffle rotates the bits of each index by one, and four exchange row and column. */
static void transpose(float *square) {
    NA_ALIGNED float other[SQUARE];
    riffle(square, other);
    riffle(other, square);
    riffle(square, other);
    riffle(other, square);
}

/* Copies `count` of a row of LANES floats. */
static void copy_row(const float *from, float *to, long count) {
    if (count == LANES)
        memcpy(to, from, LANES * sizeof(float));
    else
        for (long i = 0; i < count; i++) to[i] = from[i];
}

static long smaller(long some, long other) { return some < other ? some : other; }

/* `lanes` (count, LANES) of rows (count) that begin `stride` apart. Lanes from `present` on repeat the last row. `lanes` has
   room for whole squares. */
static void lanes_of_rows(const float *rows, long stride, long present, long count, float *lanes) {
    for (long first = 0; first < count; first += LANES, lanes += SQUARE) {
        const long columns = smaller(LANES, count - first);
        for (long l = 0; l < LANES; l++)
            copy_row(rows + smaller(l, present - 1) * stride + first, lanes + l * LANES, columns);
        transpose(lanes);
    }
}

/* The reverse. `lanes` are left in another order. */
static void rows_of_lanes(float *lanes, long stride, long present, long count, float *rows) {
    for (long first = 0; first < count; first += LANES, lanes += SQUARE) {
        const long columns = smaller(LANES, count - first);
        transpose(lanes);
        for (long l = 0; l < present; l++) copy_row(lanes + l * LANES, rows + l * stride + first, columns);
    }
}

/* `states` (B, T+1, S): `count` motions of `steps` super steps from `starts` (B, S) under `controls` (B, T, C); doubles if
   `is_double`, as `starts`, otherwise floats. Returns whether all states are small enough and all else is finite. */
int rollouts(
    const float *k, const void *starts, const float *controls, long count, long steps, void *states, long is_double
) {
    NA_ALIGNED float latent[LATENT * LANES], state[PADDED(STATE) * LANES], rows[LANES * STATE];
    NA_ALIGNED float control[PADDED(CONTROL > 0 ? CONTROL : 1) * LANES] = {0};
    double origin[LANES][AXES + 1] = {{0}};
    const size_t size = bytes_of(STATE, is_double);
    int are_sound = 1;
    for (long first = 0; first < count; first += LANES) {
        const long present = smaller(LANES, count - first);
        for (long l = 0; l < present; l++) {
            const char *start = (const char *)starts + (first + l) * size;
            memcpy((char *)states + (first + l) * (steps + 1) * size, start, size);
            are_sound &= take_apart(start, is_double, origin[l], rows + l * STATE);
        }
        lanes_of_rows(rows, STATE, present, STATE, state);
        encode(k, state, latent);
        for (long t = 0; t < steps; t++) {
            lanes_of_rows(controls + (first * steps + t) * CONTROL, steps * CONTROL, present, CONTROL, control);
            super_step_lanes(k, latent, control, latent, state);
            /* Here, while they are in the cache. */
            are_sound &= all_finite(control, CONTROL * LANES);
            rows_of_lanes(state, STATE, present, STATE, rows);
            for (long l = 0; l < present; l++) {
                const long row = (first + l) * (steps + 1) + t + 1;
                const char *start = (const char *)starts + (first + l) * size;
                are_sound &= put_together(origin[l], rows + l * STATE, start, is_double, states, row);
                move_origin(origin[l], latent + l, LANES);
            }
            for (long l = present; l < LANES; l++) move_origin(origin[LANES - 1], latent + l, LANES);
        }
    }
    return are_sound;
}
