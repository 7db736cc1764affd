/* J of the motion of some z, and its derivatives:

       z -> controls -> chain of super steps, a defect added to each -> observations of latent states -> residuals

   Varied parameters of the body come from z, too: they follow the controls, and go into the start's latent state.
   Residuals may depend on the controls, too, and unsquared values may be added to J: see `objective.c`.

   A motion is stored in rows, one for each state: the latent state, then the control applied there. */

typedef struct {
    na_objective objective;
    na_map controls, link;
    long defect;
    /* Number of varied parameters, and their entries in a latent state. */
    long varied;
    const long *entries;
} na_problem;

/* Start of motions, and the defects added to their super steps. */
typedef struct {
    const float *latent, *observed, *defects;
} na_begin;

/* Memory of one call. Names that end in 16 are lanes, or have room for them. */
typedef struct {
    float *controls, *rows, *observed, *off;
    float *controls_tape, *link_tapes, *term_tapes, *residuals_tape, *efforts_tape;
    float *z16, *controls16, *rows16, *observed16, *off16, *row16;
    float *jacobian, *live, *link_jacobians, *random;
    char *touched;
    long *lives;
    /* Whether links were differentiated one by one, so that sweeps are products of small matrices. */
    int has_link_jacobians;
} na_room;

static long sweeps(long count) { return (count + LANES - 1) / LANES; }

static long sweeps_of_link(const na_map *link) {
    return sweeps(link->inputs < link->outputs ? link->inputs : link->outputs);
}

static long cut_room(const na_problem *problem, float *memory, na_room *room) {
    const na_objective *objective = &problem->objective;
    const na_map *residuals = &objective->residuals, *efforts = &objective->efforts;
    const na_map *controls = &problem->controls, *link = &problem->link;
    const long steps = objective->steps, off = residuals->outputs + efforts->outputs;
    na_store store = {memory, 0};
    room->controls = take(&store, controls->outputs);
    room->rows = take(&store, (steps + 1) * link->inputs);
    room->observed = take(&store, residuals->inputs);
    room->off = take(&store, off);
    room->controls_tape = take(&store, controls->tape);
    room->link_tapes = take(&store, steps * link->tape);
    room->term_tapes = take(&store, tapes_of_terms(objective, 0) + tapes_of_terms(objective, 1));
    room->residuals_tape = take(&store, residuals->tape);
    room->efforts_tape = take(&store, efforts->tape);
    room->z16 = take(&store, controls->inputs * LANES);
    room->controls16 = take(&store, controls->outputs * LANES);
    room->rows16 = take(&store, (steps + 1) * link->inputs * LANES);
    room->observed16 = take(&store, residuals->inputs * LANES);
    room->off16 = take(&store, off * LANES);
    room->row16 = take(&store, link->inputs * LANES);
    room->jacobian = take(&store, off * controls->inputs);
    room->live = take(&store, off);
    room->lives = (long *)take(&store, residuals->outputs * (long)(sizeof(long) / sizeof(float)));
    room->random = take(&store, (link->outputs + steps + 1) * LANES);
    /* Otherwise it never pays to differentiate links one by one. */
    const int has_small_links = sweeps_of_link(link) < sweeps(controls->inputs);
    room->link_jacobians = take(&store, has_small_links ? steps * link->outputs * link->inputs : 0);
    room->has_link_jacobians = 0;
    room->touched = (char *)take(&store, steps + 1);
    return store.used;
}

/* Number of floats of memory that each function below needs. */
long room_of_problem(const na_problem *problem) {
    na_room room;
    return cut_room(problem, 0, &room);
}

/* The terms' observations of the start, `state` (S,), at their places in `observed`. */
void observe_start(const na_problem *problem, const float *state, float *observed, float *memory) {
    const na_objective *objective = &problem->objective;
    na_room room;
    cut_room(problem, memory, &room);
    for (long i = 0; i < objective->count; i++) {
        const na_term *term = objective->terms + i;
        for (long j = 0; j < term->count; j++, observed += term->of_state.outputs)
            if (!term->rows[j]) map_forward(&term->of_state, state, room.term_tapes, observed);
    }
}

static long control_size(const na_problem *problem) { return problem->link.inputs - problem->link.outputs; }

static long all_controls(const na_problem *problem) { return problem->objective.steps * control_size(problem); }

/* Copy the parameters that follow all `controls` into the latent state of the start, `row`, with `width` lanes. */
static void place_varied(const na_problem *problem, const float *controls, float *row, long width) {
    const float *values = controls + all_controls(problem) * width;
    for (long p = 0; p < problem->varied; p++)
        memcpy(row + problem->entries[p] * width, values + p * width, width * sizeof(float));
}

/* Copy the cotangents of the parameters from the latent state of the start, `row`, behind all `controls`; zeros without it. */
static void gather_varied(const na_problem *problem, const float *row, float *controls, long width) {
    float *values = controls + all_controls(problem) * width;
    memset(values, 0, problem->varied * width * sizeof(float));
    for (long p = 0; row && p < problem->varied; p++)
        memcpy(values + p * width, row + problem->entries[p] * width, width * sizeof(float));
}

/* The motion of `z` and its tapes, in the room. */
static void move(const na_problem *problem, const na_begin *begin, const float *z, const na_room *room) {
    const na_map *link = &problem->link;
    const long latent = link->outputs, control = control_size(problem);
    map_forward(&problem->controls, z, room->controls_tape, room->controls);
    memcpy(room->rows, begin->latent, latent * sizeof(float));
    place_varied(problem, room->controls, room->rows, 1);
    for (long t = 0; t < problem->objective.steps; t++) {
        NA_ALIGNED float nothing[LANES];
        float *row = room->rows + t * link->inputs;
        memcpy(row + latent, room->controls + t * control, control * sizeof(float));
        link->forward(
            link->constants, begin->defects + t * problem->defect, row, room->link_tapes + t * link->tape, nothing,
            row + link->inputs
        );
    }
}

/* Residuals of the motion of `z`, with ones in place of values, and all tapes, in the room; returns J. */
static double judge(const na_problem *problem, const na_begin *begin, const float *z, const na_room *room) {
    const na_objective *objective = &problem->objective;
    const na_map *residuals = &objective->residuals, *efforts = &objective->efforts;
    move(problem, begin, z, room);
    observe(objective, 0, begin->observed, room->rows, problem->link.inputs, room->term_tapes, room->observed);
    memcpy(room->observed + observed_size(objective), room->controls, objective->controls * sizeof(float));
    map_forward(residuals, room->observed, room->residuals_tape, room->off);
    map_forward(efforts, room->controls, room->efforts_tape, room->off + residuals->outputs);
    return sum_up(objective, room->off, 1);
}

/* Lanes `to` (N,) = `matrix` (N, M) times lanes `from` (M,), where `along` and `across` are the strides of its rows and
   columns. */
static void multiply(const float *matrix, long rows, long columns, long along, long across, const float *from, float *to) {
    for (long i = 0; i < rows; i += 4) {
        const na_wide *x = (const na_wide *)from;
        const float *m[4];
        na_wide sums[4];
        for (int n = 0; n < 4; n++) {
            /* Surplus rows repeat the last one. */
            m[n] = matrix + (i + n < rows ? i + n : rows - 1) * along;
            NA_ZERO(sums[n]);
        }
        for (long j = 0; j < columns; j++, x++) {
            NA_MULTIPLY_ADD(sums[0], *x, m[0][j * across]);
            NA_MULTIPLY_ADD(sums[1], *x, m[1][j * across]);
            NA_MULTIPLY_ADD(sums[2], *x, m[2][j * across]);
            NA_MULTIPLY_ADD(sums[3], *x, m[3][j * across]);
        }
        for (int n = 0; n < 4 && i + n < rows; n++) *(na_wide *)(to + (i + n) * LANES) = sums[n];
    }
}

/* The Jacobian (I, I+C) of every link, by its inputs or its outputs, whichever are fewer. */
static void differentiate_links(const na_problem *problem, const na_room *room) {
    const na_map *link = &problem->link;
    const long inputs = link->inputs, outputs = link->outputs;
    const long is_pushed = inputs <= outputs, units = is_pushed ? inputs : outputs;
    float *unit = room->row16, *result = room->rows16;
    memset(unit, 0, units * LANES * sizeof(float));
    for (long t = 0; t < problem->objective.steps; t++) {
        const float *tape = room->link_tapes + t * link->tape;
        float *jacobian = room->link_jacobians + t * outputs * inputs;
        for (long first = 0; first < units; first += LANES) {
            const long present = units - first < LANES ? units - first : LANES;
            for (long l = 0; l < present; l++) unit[(first + l) * LANES + l] = 1;
            if (is_pushed)
                map_push(link, tape, unit, result);
            else
                map_backward(link, tape, unit, result, LANES);
            for (long l = 0; l < present; l++) {
                unit[(first + l) * LANES + l] = 0;
                if (is_pushed)
                    for (long i = 0; i < outputs; i++) jacobian[i * inputs + first + l] = result[i * LANES + l];
                else
                    for (long i = 0; i < inputs; i++) jacobian[(first + l) * inputs + i] = result[i * LANES + l];
            }
        }
    }
}

/* `result`: cotangents of the row before link `t`, for `width` cotangents `of_latent` of the latent state after it. */
static void link_backward(
    const na_problem *problem, const na_room *room, long t, const float *of_latent, float *result, long width
) {
    const na_map *link = &problem->link;
    if (room->has_link_jacobians && width == LANES) {
        const float *jacobian = room->link_jacobians + t * link->outputs * link->inputs;
        multiply(jacobian, link->inputs, link->outputs, 1, link->inputs, of_latent, result);
    } else {
        map_backward(link, room->link_tapes + t * link->tape, of_latent, result, width);
    }
}

/* Lanes `latent`: tangents of the latent state after link `t`, for sixteen tangents `row` of the row before it. */
static void link_push(const na_problem *problem, const na_room *room, long t, const float *row, float *latent) {
    const na_map *link = &problem->link;
    if (room->has_link_jacobians) {
        const float *jacobian = room->link_jacobians + t * link->outputs * link->inputs;
        multiply(jacobian, link->outputs, link->inputs, link->inputs, 1, row, latent);
    } else {
        map_push(link, room->link_tapes + t * link->tape, row, latent);
    }
}

/* `z16`: cotangents of z for `width` cotangents `of_off` of the residuals of states. */
static void pull_residuals(const na_problem *problem, const na_room *room, const float *of_off, long width) {
    const na_objective *objective = &problem->objective;
    const na_map *link = &problem->link;
    const long latent = link->outputs, control = control_size(problem);
    map_backward(&objective->residuals, room->residuals_tape, of_off, room->observed16, width);
    const long last = observe_backward(
        objective, 0, room->term_tapes, room->observed16, link->inputs, room->row16, room->rows16, room->touched, width
    );
    memset(room->controls16 + last * control * width, 0, (objective->steps - last) * control * width * sizeof(float));
    for (long t = last - 1; t >= 0; t--) {
        float *row = room->rows16 + t * link->inputs * width;
        float *result = room->touched[t] ? room->row16 : row;
        link_backward(problem, room, t, row + link->inputs * width, result, width);
        memcpy(room->controls16 + t * control * width, result + latent * width, control * width * sizeof(float));
        if (result != row)
            for (long n = 0; n < latent * width; n++) row[n] += result[n];
    }
    const float *of_controls = room->observed16 + observed_size(objective) * width;
    for (long n = 0; n < objective->controls * width; n++) room->controls16[n] += of_controls[n];
    gather_varied(problem, last ? room->rows16 : 0, room->controls16, width);
    map_backward(&problem->controls, room->controls_tape, room->controls16, room->z16, width);
}

/* `z16`: cotangents of z for `width` cotangents `of_off` of the efforts. */
static void pull_efforts(const na_problem *problem, const na_room *room, const float *of_off, long width) {
    map_backward(&problem->objective.efforts, room->efforts_tape, of_off, room->controls16, width);
    gather_varied(problem, 0, room->controls16, width);
    map_backward(&problem->controls, room->controls_tape, room->controls16, room->z16, width);
}

typedef void (*na_pull)(const na_problem *problem, const na_room *room, const float *of_off, long width);

/* Rows `jacobian` of the `count` residuals `which` out of `all` (the first ones in order if it is null): unit cotangents
   are pulled back. */
static void pull_rows(
    const na_problem *problem, const na_room *room, na_pull pull, const long *which, long count, long all, float *jacobian
) {
    const long size = problem->controls.inputs;
    memset(room->off16, 0, all * LANES * sizeof(float));
    for (long at = 0; at < count; at += LANES) {
        const long present = count - at < LANES ? count - at : LANES;
        for (long l = 0; l < present; l++) room->off16[(which ? which[at + l] : at + l) * LANES + l] = 1;
        pull(problem, room, room->off16, LANES);
        for (long l = 0; l < present; l++) {
            float *row = jacobian + (at + l) * size;
            for (long i = 0; i < size; i++) row[i] = room->z16[i * LANES + l];
            room->off16[(which ? which[at + l] : at + l) * LANES + l] = 0;
        }
    }
}

/* Lanes `off16`: tangents of the residuals of states, for tangents `controls16`, and those of the latent states, which
   begin at `rows` and are `stride` lanes apart. */
static void push_observed(const na_problem *problem, const na_room *room, const float *rows, long stride) {
    const na_objective *objective = &problem->objective;
    const long latent = problem->link.outputs;
    const float *tapes = room->term_tapes;
    float *observed = room->observed16;
    for (long i = 0; i < objective->count; i++) {
        const na_term *term = objective->terms + i;
        const na_map *map = &term->of_latent;
        for (long j = 0; j < term->count; j++, observed += map->outputs * LANES, tapes += map->tape) {
            const float *row = rows + term->rows[j] * stride * LANES;
            /* The start does not vary. */
            if (!term->rows[j] || is_zero(row, latent * LANES))
                memset(observed, 0, map->outputs * LANES * sizeof(float));
            else
                map_push(map, tapes, row, observed);
        }
    }
    memcpy(observed, room->controls16, objective->controls * LANES * sizeof(float));
    map_push(&objective->residuals, room->residuals_tape, room->observed16, room->off16);
}

static void randomise(float *numbers, long count, unsigned *bits) {
    for (long n = 0; n < count; n++) {
        *bits = *bits * 1664525u + 1013904223u; /* Numerical Recipes' generator. */
        numbers[n] = (float)(*bits >> 8) * 0x1p-23f - 1.0f;
    }
}

/* Residuals of states that vary at all, `lives`: for a body that stays within its bounds, out of obstacles and upright,
   few do. Those unchanged by sixteen random tangents of every state do not. Returns their number. */
static long find_lives(const na_problem *problem, const na_room *room) {
    const long residuals = squares_of_states(&problem->objective);
    unsigned bits = 1;
    randomise(room->random, (problem->link.outputs + problem->objective.steps + 1) * LANES, &bits);
    randomise(room->controls16, problem->objective.controls * LANES, &bits);
    /* Each state begins one number further on in these, so that no two have the same tangents. */
    push_observed(problem, room, room->random, 1);
    long lives = 0;
    for (long r = 0; r < residuals; r++)
        if (!is_zero(room->off16 + r * LANES, LANES)) room->lives[lives++] = r;
    return lives;
}

/* Lanes `off16`: tangents of the residuals of states, for tangents `controls16`. */
static void push_residuals(const na_problem *problem, const na_room *room) {
    const na_objective *objective = &problem->objective;
    const na_map *link = &problem->link;
    const long latent = link->outputs, control = control_size(problem);
    int is_still = is_zero(room->controls16 + all_controls(problem) * LANES, problem->varied * LANES);
    memset(room->rows16, 0, latent * LANES * sizeof(float));
    place_varied(problem, room->controls16, room->rows16, LANES);
    for (long t = 0; t < objective->steps; t++) {
        float *row = room->rows16 + t * link->inputs * LANES;
        const float *held = room->controls16 + t * control * LANES;
        is_still = is_still && is_zero(held, control * LANES);
        if (is_still) {
            memset(row + link->inputs * LANES, 0, latent * LANES * sizeof(float));
            continue;
        }
        memcpy(row + latent * LANES, held, control * LANES * sizeof(float));
        link_push(problem, room, t, row, row + link->inputs * LANES);
    }
    push_observed(problem, room, room->rows16, link->inputs);
}

/* Lanes `off16`: tangents of the efforts, for tangents `controls16`. */
static void push_efforts(const na_problem *problem, const na_room *room) {
    map_push(&problem->objective.efforts, room->efforts_tape, room->controls16, room->off16);
}

typedef void (*na_push)(const na_problem *problem, const na_room *room);

/* The same rows `jacobian`, column by column: unit tangents of z are pushed forward. */
static void push_columns(
    const na_problem *problem, const na_room *room, na_push push, const long *which, long count, float *jacobian
) {
    const long size = problem->controls.inputs;
    memset(room->z16, 0, size * LANES * sizeof(float));
    for (long at = 0; at < size; at += LANES) {
        const long present = size - at < LANES ? size - at : LANES;
        for (long l = 0; l < present; l++) room->z16[(at + l) * LANES + l] = 1;
        map_push(&problem->controls, room->controls_tape, room->z16, room->controls16);
        push(problem, room);
        for (long r = 0; r < count; r++)
            memcpy(jacobian + r * size + at, room->off16 + (which ? which[r] : r) * LANES, present * sizeof(float));
        for (long l = 0; l < present; l++) room->z16[(at + l) * LANES + l] = 0;
    }
}

/* For residuals with the Jacobian `rows` (R, Z): `curvature` (Z, Z), rows' rows, and `slope` (Z,), rows' residuals. */
static void sum_squares(
    const float *rows, const float *residuals, long count, long size, float *curvature, float *slope
) {
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

/* J near `z` (Z,): `curvature` (Z, Z), without the values, and `slope` (Z,); returns J itself. */
double quadratic_model(
    const na_problem *problem, const na_begin *begin, const float *z, float *curvature, float *slope, float *memory
) {
    const long residuals = problem->objective.residuals.outputs, efforts = problem->objective.efforts.outputs;
    na_room room;
    cut_room(problem, memory, &room);
    const double cost = judge(problem, begin, z, &room);
    const long size = problem->controls.inputs, lives = find_lives(problem, &room);
    const long varied = sweeps(size), pulled = sweeps(lives), fewer = varied < pulled ? varied : pulled;
    /* If links take fewer sweeps than that, the rest is products of small matrices. */
    room.has_link_jacobians = sweeps_of_link(&problem->link) < fewer;
    if (room.has_link_jacobians) differentiate_links(problem, &room);
    if (varied < pulled)
        push_columns(problem, &room, push_residuals, room.lives, lives, room.jacobian);
    else
        pull_rows(problem, &room, pull_residuals, room.lives, lives, residuals, room.jacobian);
    float *of_efforts = room.jacobian + lives * size;
    if (varied < sweeps(efforts))
        push_columns(problem, &room, push_efforts, 0, efforts, of_efforts);
    else
        pull_rows(problem, &room, pull_efforts, 0, efforts, efforts, of_efforts);
    for (long r = 0; r < lives; r++) room.live[r] = room.off[room.lives[r]];
    memcpy(room.live + lives, room.off + residuals, efforts * sizeof(float));
    sum_squares(room.jacobian, room.live, lives + efforts, size, curvature, slope);
    if (problem->objective.values) {
        memset(room.off, 0, squares_of_states(&problem->objective) * sizeof(float));
        pull_residuals(problem, &room, room.off, 1);
        for (long i = 0; i < size; i++) slope[i] += room.z16[i];
    }
    return cost;
}

/* The `slope` (Z,) of J at `z` (Z,); returns J. */
double gradient(const na_problem *problem, const na_begin *begin, const float *z, float *slope, float *memory) {
    const long residuals = problem->objective.residuals.outputs;
    na_room room;
    cut_room(problem, memory, &room);
    const double cost = judge(problem, begin, z, &room);
    pull_residuals(problem, &room, room.off, 1);
    memcpy(slope, room.z16, problem->controls.inputs * sizeof(float));
    pull_efforts(problem, &room, room.off + residuals, 1);
    for (long i = 0; i < problem->controls.inputs; i++) slope[i] += room.z16[i];
    return cost;
}

/* `controls` (T, C) of `z` (Z,), and the `latents` (T+1, I) of their motion. */
void motion(
    const na_problem *problem, const na_begin *begin, const float *z, float *controls, float *latents, float *memory
) {
    const na_map *link = &problem->link;
    na_room room;
    cut_room(problem, memory, &room);
    move(problem, begin, z, &room);
    memcpy(controls, room.controls, all_controls(problem) * sizeof(float));
    for (long t = 0; t <= problem->objective.steps; t++)
        memcpy(latents + t * link->outputs, room.rows + t * link->inputs, link->outputs * sizeof(float));
}

/* J of each of at most sixteen `zs` (K, Z). */
static void costs_in_lanes(
    const na_problem *problem, const na_begin *begin, const float *zs, long count, double *costs, const na_room *room
) {
    const na_objective *objective = &problem->objective;
    const na_map *residuals = &objective->residuals, *efforts = &objective->efforts, *link = &problem->link;
    const long latent = link->outputs, control = control_size(problem), size = problem->controls.inputs;
    /* Surplus lanes repeat the last z. */
    for (long l = 0; l < LANES; l++)
        for (long i = 0; i < size; i++) room->z16[i * LANES + l] = zs[(l < count ? l : count - 1) * size + i];
    map_lanes(&problem->controls, room->z16, room->controls16);
    for (long i = 0; i < latent; i++)
        for (long l = 0; l < LANES; l++) room->rows16[i * LANES + l] = begin->latent[i];
    place_varied(problem, room->controls16, room->rows16, LANES);
    for (long t = 0; t < objective->steps; t++) {
        float *row = room->rows16 + t * link->inputs * LANES;
        memcpy(row + latent * LANES, room->controls16 + t * control * LANES, control * LANES * sizeof(float));
        link->lanes(link->constants, begin->defects + t * problem->defect, row, row + link->inputs * LANES);
    }
    const float *of_start = begin->observed;
    float *observed = room->observed16;
    for (long i = 0; i < objective->count; i++) {
        const na_term *term = objective->terms + i;
        const na_map *map = &term->of_latent;
        for (long j = 0; j < term->count; j++, observed += map->outputs * LANES, of_start += map->outputs)
            if (term->rows[j])
                map_lanes(map, room->rows16 + term->rows[j] * link->inputs * LANES, observed);
            else
                for (long n = 0; n < map->outputs * LANES; n++) observed[n] = of_start[n / LANES];
    }
    memcpy(observed, room->controls16, objective->controls * LANES * sizeof(float));
    map_lanes(residuals, room->observed16, room->off16);
    map_lanes(efforts, room->controls16, room->off16 + residuals->outputs * LANES);
    for (long l = 0; l < count; l++) costs[l] = sum_up(objective, room->off16 + l, LANES);
}

/* Maximum number of z that are faster one after the other than in parallel. */
enum { FEW_COSTS = 6 };

/* J of each of `zs` (K, Z). */
void costs(
    const na_problem *problem, const na_begin *begin, const float *zs, long count, double *costs, float *memory
) {
    na_room room;
    cut_room(problem, memory, &room);
    for (long first = 0; first < count; first += LANES) {
        const long present = count - first < LANES ? count - first : LANES;
        const float *some = zs + first * problem->controls.inputs;
        if (present > FEW_COSTS)
            costs_in_lanes(problem, begin, some, present, costs + first, &room);
        else
            for (long n = 0; n < present; n++)
                costs[first + n] = judge(problem, begin, some + n * problem->controls.inputs, &room);
    }
}
