/* The fish's super step by hand: a frame, shape modes, activations; a linear map and one layer of gated units, odd and even
   apart. Sizes are defined before; weights come in the order of `enum weights`, columns padded with zeros. */
enum weights { W_MIXING, W_UNMIXING, W_ORDER, W_LOW, W_HIGH, W_MEAN, W_SCALE, W_ODD, W_EVEN, W_BIAS, W_ODD_OUT, W_EVEN_OUT,
               W_ODD_LINEAR, W_EVEN_LINEAR, W_ANSWER, W_CHANGE_MEAN, W_CHANGE_SCALE, W_INVERSE_SPREAD, W_LIMITS,
               W_POSITIONS, W_VELOCITIES, W_MEAN_POSITION, W_MEAN_VELOCITY };
enum { POSITION = 0, QUATERNION = 3, VELOCITY = 7, SPIN = 10, MODES = 13, ACTIVATIONS = MODES + MODE_COUNT };
enum { LATENT = ACTIVATIONS + CONTROL, SHOWN = LATENT - SPIN };
enum { INPUTS = PADDED(ODD_FEATURES) + PADDED(FEATURES - ODD_FEATURES), AXIS = PADDED(POINTS) };
enum { EVEN_POSITIONS = MODE_COUNT - ODD_POSITIONS - ODD_VELOCITIES - EVEN_VELOCITIES };

typedef struct { float rows[3][3]; } rotation;

static rotation rotation_of(const float *q) {
    const float w = q[0], x = q[1], y = q[2], z = q[3];
    return (rotation){{
        {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
        {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
        {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)},
    }};
}

static void rotate(const rotation *r, const float *v, float *result) {
    for (int i = 0; i < 3; i++) result[i] = r->rows[i][0] * v[0] + r->rows[i][1] * v[1] + r->rows[i][2] * v[2];
}

static float shrink(float limit, float square) {
    const float share = limit / sqrtf(square + 1e-12f);
    return share < 1 ? share : 1;
}

/* Modes of positions and of velocities, each with the odd ones first; they lie in turns in a latent state. */
static void part_modes(const float *modes, float *positions, float *velocities) {
    memcpy(positions, modes, ODD_POSITIONS * sizeof(float));
    memcpy(velocities, modes + ODD_POSITIONS, ODD_VELOCITIES * sizeof(float));
    memcpy(positions + ODD_POSITIONS, modes + ODD_POSITIONS + ODD_VELOCITIES, EVEN_POSITIONS * sizeof(float));
    memcpy(velocities + ODD_VELOCITIES, modes + MODE_COUNT - EVEN_VELOCITIES, EVEN_VELOCITIES * sizeof(float));
}

static void join_modes(const float *positions, const float *velocities, float *modes) {
    memcpy(modes, positions, ODD_POSITIONS * sizeof(float));
    memcpy(modes + ODD_POSITIONS, velocities, ODD_VELOCITIES * sizeof(float));
    memcpy(modes + ODD_POSITIONS + ODD_VELOCITIES, positions + ODD_POSITIONS, EVEN_POSITIONS * sizeof(float));
    memcpy(modes + MODE_COUNT - EVEN_VELOCITIES, velocities + ODD_VELOCITIES, EVEN_VELOCITIES * sizeof(float));
}

static float mean_square(const float *numbers, const float *inverse_spread, int count) {
    float parts[LANES] = {0};
    int i = 0;
    for (; i + LANES <= count; i += LANES)
        for (int l = 0; l < LANES; l++) {
            const float number = numbers[i + l] * inverse_spread[i + l];
            parts[l] += number * number;
        }
    for (; i < count; i++) parts[0] += numbers[i] * inverse_spread[i] * numbers[i] * inverse_spread[i];
    float sum = 0;
    for (int l = 0; l < LANES; l++) sum += parts[l];
    return sum / count;
}

static void predict(const float *const *w, const float *raw, float *answers) {
    float inputs[INPUTS], sums[PADDED(3 * HALF)] = {0}, levels[PADDED(2 * HALF)], odd[HALF], even[HALF];
    const int *order = (const int *)w[W_ORDER];
    const float *low = w[W_LOW], *high = w[W_HIGH], *mean = w[W_MEAN], *scale = w[W_SCALE], *others = inputs + PADDED(ODD_FEATURES);
    for (int i = 0; i < INPUTS; i++) inputs[i] = raw[order[i]];
    for (int i = 0; i < INPUTS; i++) inputs[i] = (between(low[i], inputs[i], high[i]) - mean[i]) * scale[i];
    memcpy(levels, w[W_BIAS], sizeof levels);
    multiply_add(inputs, ODD_FEATURES, w[W_ODD], 3 * HALF, sums);
    multiply_add(others, FEATURES - ODD_FEATURES, w[W_EVEN], 2 * HALF, levels);
    gate(HALF, sums, levels, odd, even);
    memset(answers, 0, (PADDED(ODD_ANSWERS) + PADDED(EVEN_ANSWERS)) * sizeof(float));
    multiply_add(inputs, ODD_FEATURES, w[W_ODD_LINEAR], ODD_ANSWERS, answers);
    multiply_add(odd, HALF, w[W_ODD_OUT], ODD_ANSWERS, answers);
    multiply_add(others, FEATURES - ODD_FEATURES, w[W_EVEN_LINEAR], EVEN_ANSWERS, answers + PADDED(ODD_ANSWERS));
    multiply_add(even, HALF, w[W_EVEN_OUT], EVEN_ANSWERS, answers + PADDED(ODD_ANSWERS));
}

static void keep_within(const float *const *w, float *latent) {
    float positions[POSITION_MODES], velocities[MODE_COUNT - POSITION_MODES];
    const float *spread = w[W_INVERSE_SPREAD], *limits = w[W_LIMITS], *v = latent + VELOCITY, *s = latent + SPIN;
    part_modes(latent + MODES, positions, velocities);
    const float of_positions = shrink(limits[0], mean_square(positions, spread, POSITION_MODES));
    const float of_velocities = shrink(limits[1], mean_square(velocities, spread + POSITION_MODES, MODE_COUNT - POSITION_MODES));
    const float of_speed = shrink(limits[2], v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    const float of_spin = shrink(limits[3], s[0] * s[0] + s[1] * s[1] + s[2] * s[2]);
    for (int i = 0; i < POSITION_MODES; i++) positions[i] *= of_positions;
    for (int i = 0; i < MODE_COUNT - POSITION_MODES; i++) velocities[i] *= of_velocities;
    for (int i = 0; i < 3; i++) latent[VELOCITY + i] *= of_speed;
    for (int i = 0; i < 3; i++) latent[SPIN + i] *= of_spin;
    join_modes(positions, velocities, latent + MODES);
}

static void super_step(const float *const *w, float *restrict latent, const float *restrict control) {
    float raw[FEATURES], mixed[PADDED(CONTROL)] = {0}, answers[PADDED(ODD_ANSWERS) + PADDED(EVEN_ANSWERS)], change[CHANGES];
    const rotation r = rotation_of(latent + QUATERNION);
    multiply_add(control, CONTROL, w[W_MIXING], CONTROL, mixed);
    memcpy(raw, latent + SPIN, SHOWN * sizeof(float));
    for (int i = 0; i < 3; i++) raw[SHOWN + i] = r.rows[2][i];
    for (int i = 0; i < 3; i++) {
        const float *v = latent + VELOCITY;
        raw[SHOWN + 3 + i] = r.rows[0][i] * v[0] + r.rows[1][i] * v[1] + r.rows[2][i] * v[2];
    }
    memcpy(raw + SHOWN + 6, mixed, CONTROL * sizeof(float));
    predict(w, raw, answers);
    const int *answer = (const int *)w[W_ANSWER];
    for (int i = 0; i < CHANGES; i++) change[i] = answers[answer[i]];
    const float *mean = w[W_CHANGE_MEAN], *scale = w[W_CHANGE_SCALE];
    for (int i = 0; i < CHANGES; i++) change[i] = mean[i] + scale[i] * change[i];

    float moved[3], pushed[3];
    rotate(&r, change, moved);
    rotate(&r, change + 6, pushed);
    for (int i = 0; i < 3; i++) latent[POSITION + i] += DT * latent[VELOCITY + i] + moved[i];
    const float *q = latent + QUATERNION;
    const float b = 0.5f * (DT * latent[SPIN] + change[3]), c = 0.5f * (DT * latent[SPIN + 1] + change[4]);
    const float d = 0.5f * (DT * latent[SPIN + 2] + change[5]);
    const float turned[4] = {
        q[0] - q[1] * b - q[2] * c - q[3] * d, q[0] * b + q[1] + q[2] * d - q[3] * c,
        q[0] * c - q[1] * d + q[2] + q[3] * b, q[0] * d + q[1] * c - q[2] * b + q[3],
    };
    const float length = sqrtf(turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2] + turned[3] * turned[3]);
    for (int i = 0; i < 4; i++) latent[QUATERNION + i] = turned[i] / length;
    for (int i = 0; i < 3; i++) latent[VELOCITY + i] += pushed[i];
    for (int i = 0; i < 3 + MODE_COUNT; i++) latent[SPIN + i] += change[9 + i];
    for (int i = 0; i < CONTROL; i++) latent[ACTIVATIONS + i] = mixed[i] + LEFT * (latent[ACTIVATIONS + i] - mixed[i]);
    keep_within(w, latent);
}

/* Points lie by axis: all x, all y, all z, each padded to whole vectors. */
static void decode(const float *const *w, const float *restrict latent, float *restrict state) {
    float positions[POSITION_MODES], velocities[MODE_COUNT - POSITION_MODES], shape[3 * AXIS], flow[3 * AXIS];
    float place[3][AXIS], speed[3][AXIS], activations[PADDED(CONTROL)] = {0};
    const rotation r = rotation_of(latent + QUATERNION);
    const float a = latent[SPIN], b = latent[SPIN + 1], c = latent[SPIN + 2];
    part_modes(latent + MODES, positions, velocities);
    memcpy(shape, w[W_MEAN_POSITION], sizeof shape);
    memcpy(flow, w[W_MEAN_VELOCITY], sizeof flow);
    multiply_add(positions, POSITION_MODES, w[W_POSITIONS], 3 * AXIS, shape);
    multiply_add(velocities, MODE_COUNT - POSITION_MODES, w[W_VELOCITIES], 3 * AXIS, flow);
    const float *x = shape, *y = shape + AXIS, *z = shape + 2 * AXIS;
    float *u = flow, *v = flow + AXIS, *o = flow + 2 * AXIS;
    for (int n = 0; n < AXIS; n++) {
        u[n] += b * z[n] - c * y[n];
        v[n] += c * x[n] - a * z[n];
        o[n] += a * y[n] - b * x[n];
    }
    for (int i = 0; i < 3; i++) {
        const float to_x = r.rows[i][0], to_y = r.rows[i][1], to_z = r.rows[i][2];
        const float at = latent[POSITION + i], drift = latent[VELOCITY + i];
        for (int n = 0; n < AXIS; n++) place[i][n] = at + to_x * x[n] + to_y * y[n] + to_z * z[n];
        for (int n = 0; n < AXIS; n++) speed[i][n] = drift + to_x * u[n] + to_y * v[n] + to_z * o[n];
    }
    for (int n = 0; n < POINTS; n++)
        for (int i = 0; i < 3; i++) {
            state[3 * n + i] = place[i][n];
            state[POINTS3 + 3 * n + i] = speed[i][n];
        }
    multiply_add(latent + ACTIVATIONS, CONTROL, w[W_UNMIXING], CONTROL, activations);
    memcpy(state + 2 * POINTS3, activations, CONTROL * sizeof(float));
}

/* `states` (T, S): the ones after each of `steps` super steps from the latent `start` under `controls` (T, C). */
void rollout(const float *const *w, const float *start, const float *controls, long steps, float *states) {
    float latent[LATENT];
    memcpy(latent, start, sizeof latent);
    for (long t = 0; t < steps; t++) {
        super_step(w, latent, controls + t * CONTROL);
        decode(w, latent, states + t * (2 * POINTS3 + CONTROL));
    }
}
