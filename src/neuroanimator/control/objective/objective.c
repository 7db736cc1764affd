/* J of a motion. Each term observes single states, at its `rows` of the motion. `residuals` are a function of all
   observations, concatenated, perhaps followed by the controls; `efforts` are a function of the controls alone. J is half
   the sum of all their squares, but the last of the `residuals` may be values that are added unsquared.
   Arrays are in C order; those of lanes have sixteen numbers for each one. */

typedef struct {
    na_map of_latent, of_state;
    const long *rows;
    long count;
} na_term;

typedef struct {
    const na_term *terms;
    long count;
    na_map residuals, efforts;
    /* `controls`: number of controls that `residuals` looks at; `values`: number of its outputs that are added unsquared. */
    long steps, state, controls, values;
} na_objective;

/* Allocates whole registers from one piece of memory; without memory, it measures how much is needed. */
typedef struct {
    float *memory;
    long used;
} na_store;

static float *take(na_store *store, long count) {
    float *room = store->memory ? store->memory + store->used : 0;
    store->used += (count + LANES - 1) / LANES * LANES;
    return room;
}

static long observed_size(const na_objective *objective) { return objective->residuals.inputs - objective->controls; }

/* Number of residuals of states: outputs of `residuals` that are squared. */
static long squares_of_states(const na_objective *objective) { return objective->residuals.outputs - objective->values; }

/* J of `off`, the outputs of `residuals` and then of `efforts`, `stride` floats apart. The values, which are not squared,
   are set to one: `off` is then the gradient of J by these numbers. */
static double sum_up(const na_objective *objective, float *off, long stride) {
    const long squares = squares_of_states(objective), all = objective->residuals.outputs;
    double sum = 0.0, values = 0.0;
    for (long i = 0; i < squares; i++) sum += (double)off[i * stride] * off[i * stride];
    for (long i = squares; i < all; i++) {
        values += off[i * stride];
        off[i * stride] = 1;
    }
    for (long i = all; i < all + objective->efforts.outputs; i++) sum += (double)off[i * stride] * off[i * stride];
    return sum / 2 + values;
}

static int is_zero(const float *numbers, long count) {
    int is_any = 0;
    for (long i = 0; i < count; i++) is_any |= numbers[i] != 0;
    return !is_any;
}

static const na_map *map_of(const na_term *term, int whole) { return whole ? &term->of_state : &term->of_latent; }

/* Number of floats on the tapes of all observations of whole states, or else of latent ones. */
static long tapes_of_terms(const na_objective *objective, int whole) {
    long count = 0;
    for (long i = 0; i < objective->count; i++)
        count += objective->terms[i].count * map_of(objective->terms + i, whole)->tape;
    return count;
}

/* Observations `observed` of the rows of a motion, `stride` floats apart, and their tapes. Those of the start are taken
   from `of_start`, unless it is null. */
static void observe(
    const na_objective *objective, int whole, const float *of_start, const float *rows, long stride, float *tapes,
    float *observed
) {
    for (long i = 0; i < objective->count; i++) {
        const na_term *term = objective->terms + i;
        const na_map *map = map_of(term, whole);
        for (long j = 0; j < term->count; j++) {
            if (of_start && !term->rows[j])
                memcpy(observed, of_start, map->outputs * sizeof(float));
            else
                map_forward(map, rows + term->rows[j] * stride, tapes, observed);
            if (of_start) of_start += map->outputs;
            observed += map->outputs;
            tapes += map->tape;
        }
    }
}

/* Add the cotangents of the rows for `width` cotangents `of_observed` to `of_rows`, `stride` numbers apart. Only rows with
   contributions are written, which `touched` marks. Returns the last one touched. */
static long observe_backward(
    const na_objective *objective, int whole, const float *tapes, const float *of_observed, long stride, float *of_row,
    float *of_rows, char *touched, long width
) {
    long last = 0;
    memset(touched, 0, objective->steps + 1);
    for (long i = 0; i < objective->count; i++) {
        const na_term *term = objective->terms + i;
        const na_map *map = map_of(term, whole);
        for (long j = 0; j < term->count; j++, of_observed += map->outputs * width, tapes += map->tape) {
            const long row = term->rows[j];
            /* The start does not vary. */
            if ((!whole && !row) || is_zero(of_observed, map->outputs * width)) continue;
            float *target = of_rows + row * stride * width;
            if (touched[row]) {
                map_backward(map, tapes, of_observed, of_row, width);
                for (long n = 0; n < map->inputs * width; n++) target[n] += of_row[n];
            } else {
                map_backward(map, tapes, of_observed, target, width);
                touched[row] = 1;
                if (row > last) last = row;
            }
        }
    }
    return last;
}

/* Memory for judging a motion of states. */
typedef struct {
    float *tapes, *residuals_tape, *efforts_tape, *observed, *off, *of_observed, *of_row;
    char *touched;
} na_judging;

/* Allocate `judging` from memory, and return the number of floats it takes. */
static long cut_judging(const na_objective *objective, float *memory, na_judging *judging) {
    const na_map *residuals = &objective->residuals, *efforts = &objective->efforts;
    na_store store = {memory, 0};
    judging->tapes = take(&store, tapes_of_terms(objective, 1));
    judging->residuals_tape = take(&store, residuals->tape);
    judging->efforts_tape = take(&store, efforts->tape);
    judging->observed = take(&store, residuals->inputs);
    judging->off = take(&store, residuals->outputs + efforts->outputs);
    judging->of_observed = take(&store, residuals->inputs);
    judging->of_row = take(&store, objective->state);
    judging->touched = (char *)take(&store, objective->steps + 1);
    return store.used;
}

/* Number of floats of memory that the next two functions need. */
long room_of_objective(const na_objective *objective) {
    na_judging judging;
    return cut_judging(objective, 0, &judging);
}

/* J of `states` (T+1, S) under `controls` (T, C). */
double cost_of_states(const na_objective *objective, const float *states, const float *controls, float *memory) {
    const na_map *residuals = &objective->residuals, *efforts = &objective->efforts;
    na_judging room;
    cut_judging(objective, memory, &room);
    observe(objective, 1, 0, states, objective->state, room.tapes, room.observed);
    memcpy(room.observed + observed_size(objective), controls, objective->controls * sizeof(float));
    map_forward(residuals, room.observed, room.residuals_tape, room.off);
    map_forward(efforts, controls, room.efforts_tape, room.off + residuals->outputs);
    return sum_up(objective, room.off, 1);
}

/* J and its gradients by the states, `by_states` (T+1, S), and by the controls, `by_controls` (T, C). */
double slopes_of_states(
    const na_objective *objective, const float *states, const float *controls, float *by_states, float *by_controls,
    float *memory
) {
    const na_map *residuals = &objective->residuals, *efforts = &objective->efforts;
    const double cost = cost_of_states(objective, states, controls, memory);
    na_judging room;
    cut_judging(objective, memory, &room);
    memset(by_states, 0, (objective->steps + 1) * objective->state * sizeof(float));
    map_backward(residuals, room.residuals_tape, room.off, room.of_observed, 1);
    observe_backward(
        objective, 1, room.tapes, room.of_observed, objective->state, room.of_row, by_states, room.touched, 1
    );
    map_backward(efforts, room.efforts_tape, room.off + residuals->outputs, by_controls, 1);
    const float *of_controls = room.of_observed + observed_size(objective);
    for (long i = 0; i < objective->controls; i++) by_controls[i] += of_controls[i];
    return cost;
}
