/* What a page calls: one problem, the numbers of its objective and its start as data. Arrays are in C's order, of float32
   unless said otherwise; those that a caller passes begin at multiples of 64 bytes. */

/* What may be moved between calls: weights, goals and tolerances, then the scale of controls. */
NA_ALIGNED float descent_numbers[NUMBERS] = {@numbers@};

/* (T, V) What is added to every super step: see `descent_defects_of`. */
NA_ALIGNED float descent_defects[STEPS * DEFECT];

@rows@
static const na_term descent_terms[] = {@terms@};

static const na_problem descent_problem = {
    {descent_terms, @count@, @residuals@, @efforts@, STEPS, STATE, @looked_at@, @values@},
    @controls@,
    @link@,
    DEFECT,
};

NA_ALIGNED static float descent_start[STATE];
NA_ALIGNED static float descent_latent[LATENT];
NA_ALIGNED static float descent_observed[OBSERVED];

static const na_begin descent_begin = {descent_latent, descent_observed, descent_defects};

/* Floats of `memory` that each function below needs. */
int descent_room(void) { return (int)room_of_problem(&descent_problem); }

/* Motions begin at `state` (S,) from now on; to be called anew when numbers were moved, too. */
void descent_begin_at(const float *state, float *memory) {
    memcpy(descent_start, state, sizeof descent_start);
    descent_encode(descent_k, state, descent_latent);
    memset(descent_observed, 0, sizeof descent_observed);
    observe_start(&descent_problem, state, descent_observed, memory);
}

/* J of each of `zs` (K, Z), in double precision. */
void descent_costs(const float *zs, int count, double *costs_of_zs, float *memory) {
    costs(&descent_problem, &descent_begin, zs, count, costs_of_zs, memory);
}

/* J near `z` (Z,): Gauss-Newton's `curvature` (Z, Z), `slope` (Z,), and J itself, which is returned. */
double descent_quadratic_model(const float *z, float *curvature, float *slope, float *memory) {
    return quadratic_model(&descent_problem, &descent_begin, z, curvature, slope, memory);
}

/* `controls` (T, C) of `z` (Z,), the `latents` (T+1, I) they lead to, and the `states` (T+1, S) these stand for. */
void descent_motion(const float *z, float *controls, float *latents, float *states, float *memory) {
    motion(&descent_problem, &descent_begin, z, controls, latents, memory);
    memcpy(states, descent_start, sizeof descent_start);
    for (int t = 1; t <= STEPS; t++) descent_decode(descent_k, latents + t * LATENT, states + t * STATE);
}

/* `defects` (T, V) with which the emulator goes through `states` (T+1, S), to which `controls` (T, C) led on the physics. */
void descent_defects_of(const float *states, const float *controls, float *defects) {
    static const float none[DEFECT];
    static float tape[@link_tape@];
    NA_ALIGNED float nothing[LANES], row[LATENT + CONTROL], predicted[LATENT], actual[LATENT];
    for (int t = 0; t < STEPS; t++) {
        descent_encode(descent_k, states + t * STATE, row);
        memcpy(row + LATENT, controls + t * CONTROL, CONTROL * sizeof(float));
        descent_link_forward(descent_k, none, row, tape, nothing, predicted);
        descent_encode(descent_k, states + (t + 1) * STATE, actual);
        descent_difference(descent_k, predicted, actual, defects + t * DEFECT);
    }
}
