/* The loop of physics/deformable/mass_spring.py in C, for one body: the pull of springs at mass points, step by step.

   source.py puts the text of the body before this one: numbers as constants, springs and faces as lists
   X(...) X(...), so that the compiler sees straight code, and FORMULAS, the forces, generated from those in JAX.
   In a family of bodies the numbers follow from the PARAMETERS, the last entries of a state, once for every motion.
   REAL is float or double. LANES bodies lie side by side; one body alone is four numbers a mass point, so that three
   axes are one vector operation. */

#include <math.h>
#include <string.h>

typedef REAL real;
#if LANES == 1
#define PARTS 1
#define PART 4
#else
#define PARTS 3
#define PART LANES
#endif
#define WIDE (PARTS * PART)
#define AXIS (WIDE == 4 ? 1 : LANES) /* from one axis of a mass point to the next */
#define ALIGNED __attribute__((aligned(64)))
#define INLINE static inline __attribute__((always_inline))
#define EACH_PART for (int part = 0; part < PARTS; part++)
#define EACH_LANE _Pragma("GCC ivdep") _Pragma("GCC unroll 1") for (int l = 0; l < LANES; l++)
#define STATE (6 * POINTS + MUSCLES + PARAMETERS)
#define ROOM(count) ((count) ? (count) : 1)
#define LONG(count) (LANES == 1 ? ((count) + 15) / 16 * 16 : (count)) /* whole vectors: no remainder loops */
#define TOGETHER(count) (LANES == 1 ? LONG(count) : 1) /* one body: stage by stage; many: spring by spring, in cache */

typedef real vector __attribute__((vector_size(PART * sizeof(real)), aligned(PART * sizeof(real)), may_alias));
typedef real Forces[POINTS][WIDE] ALIGNED;
typedef real Springs[LONG(SPRINGS)][LANES] ALIGNED;
typedef struct { /* the numbers that vary over a family of bodies */
    Springs stiffness, damping, length;
    real mass[POINTS][LANES] ALIGNED, lightness[POINTS][LANES] ALIGNED;
    real face_drag[LANES] ALIGNED, drag[LANES] ALIGNED;
} Numbers;
typedef struct {
    real positions[POINTS][WIDE] ALIGNED, velocities[POINTS][WIDE] ALIGNED;
    real activations[ROOM(MUSCLES)][LANES] ALIGNED, controls[ROOM(CONTROLS)][LANES] ALIGNED;
    real parameters[ROOM(PARAMETERS)][LANES] ALIGNED;
    const Numbers *numbers;
} BodyState;

#define AS_VECTOR(numbers) (((vector *)(numbers))[part])
#define VECTOR(array, i) AS_VECTOR((array)[i])
#if LANES == 1
#define SPREAD(numbers) ((numbers)[0] - (vector){0})
#else
#define SPREAD(numbers) (*(const vector *)(numbers))
#endif

#if PARAMETERS
#define SPRING(name, constants, s) m->numbers->name[s][l]
#define POINT(name, constants, i) m->numbers->name[i][l]
#define POINT_PART(name, constants, i) SPREAD(m->numbers->name[i])
#define SHORTENING(spring, share) ((real)(share) * m->numbers->length[spring][l])
#define WATER(name) , m->numbers->name[l]
#else
#define SPRING(name, constants, s) constants[s]
#define POINT(name, constants, i) constants[i]
#define POINT_PART(name, constants, i) constants[i]
#define SHORTENING(spring, metres) (real)(metres)
#define WATER(name)
#endif

FORMULAS

INLINE real larger(real a, real b) { return a > b ? a : b; }

INLINE void span(const BodyState *m, int a, int b, real extent[WIDE], real parting[WIDE]) {
    EACH_PART {
        AS_VECTOR(extent) = VECTOR(m->positions, b) - VECTOR(m->positions, a);
        AS_VECTOR(parting) = VECTOR(m->velocities, b) - VECTOR(m->velocities, a);
    }
}

/* Effective stiffness of spring `s`: times its extent it is its force. */
INLINE void stretch(
    const BodyState *m, int s, const real extent[WIDE], const real parting[WIDE], const real rest[LANES], real result[LANES]
) {
    (void)m;
    EACH_LANE result[l] = spring_stiffness(
        extent + l, parting + l, SPRING(stiffness, STIFFNESS, s), SPRING(damping, DAMPING, s), rest[l]
    );
}

INLINE void pull(int a, int b, const real stiffness[LANES], const real extent[WIDE], Forces force) {
    EACH_PART {
        vector toward = SPREAD(stiffness) * AS_VECTOR(extent);
        VECTOR(force, a) += toward;
        VECTOR(force, b) -= toward;
    }
}

INLINE void add_springs(const BodyState *m, Springs stiffness, Forces force) {
    real extent[TOGETHER(SPRINGS)][WIDE] ALIGNED, parting[TOGETHER(SPRINGS)][WIDE] ALIGNED;
    Springs rest;
    for (int s = 0; s < LONG(SPRINGS); s++) EACH_LANE rest[s][l] = SPRING(length, LENGTH, s);
#define X(spring, muscle, metres) EACH_LANE rest[spring][l] -= SHORTENING(spring, metres) * m->activations[muscle][l];
    MUSCLE_LIST(X)
#undef X
#if LANES == 1
#define X(spring, a, b) span(m, a, b, extent[spring], parting[spring]);
    SPRING_LIST(X)
#undef X
    for (int s = 0; s < LONG(SPRINGS); s++) stretch(m, s, extent[s], parting[s], rest[s], stiffness[s]);
#define X(spring, a, b) pull(a, b, stiffness[spring], extent[spring], force);
    SPRING_LIST(X)
#undef X
#else
#define X(spring, a, b)                                                     \
    span(m, a, b, *extent, *parting);                                       \
    stretch(m, spring, *extent, *parting, rest[spring], stiffness[spring]); \
    pull(a, b, stiffness[spring], *extent, force);
    SPRING_LIST(X)
#undef X
#endif
}

/* The share of every mass point that is under water. */
INLINE void soak(const BodyState *m, real wet[POINTS][LANES]) {
#ifdef SURFACE
    for (int i = 0; i < POINTS; i++)
        EACH_LANE wet[i][l] = wetness(m->positions[i][2 * AXIS + l]);
#else
    (void)m, (void)wet;
#endif
}

#if FACES
typedef struct {
    real right[WIDE], up[WIDE], flow[WIDE], wet[PART];
} Face;

/* The diagonals of a face, and the sums over its corners of velocity and wetness. */
INLINE void measure_face(const BodyState *m, real wet[POINTS][LANES], int a, int b, int c, int d, int fourth, Face *face) {
    EACH_PART {
        AS_VECTOR(face->right) = VECTOR(m->positions, c) - VECTOR(m->positions, a);
        AS_VECTOR(face->up) = VECTOR(m->positions, d) - VECTOR(m->positions, b);
        AS_VECTOR(face->flow) =
            VECTOR(m->velocities, a) + VECTOR(m->velocities, b) + VECTOR(m->velocities, c) + VECTOR(m->velocities, d) * (real)fourth;
    }
#ifdef SURFACE
    EACH_LANE face->wet[l] = wet[a][l] + wet[b][l] + wet[c][l] + (real)fourth * wet[d][l];
#else
    (void)wet;
#endif
}

/* The water's push on face `f`, as the force on each of its corners. */
INLINE void push(const BodyState *m, int f, const Face *face, real force[WIDE]) {
    (void)m;
    EACH_LANE {
#ifdef SURFACE
        const real wet = face->wet[l] * SHARE[f];
#else
        const real wet = 1;
#endif
        corner_force(face->right + l, face->up + l, face->flow + l, wet, SHARE[f] WATER(face_drag), force + l);
    }
}

INLINE void share(int a, int b, int c, int d, int fourth, const real push[WIDE], Forces force) {
    EACH_PART {
        VECTOR(force, a) += AS_VECTOR(push);
        VECTOR(force, b) += AS_VECTOR(push);
        VECTOR(force, c) += AS_VECTOR(push);
        if (fourth) VECTOR(force, d) += AS_VECTOR(push);
    }
}
#endif

INLINE void add_faces(const BodyState *m, real wet[POINTS][LANES], Forces force) {
#if FACES
    Face faces[TOGETHER(FACES)] ALIGNED;
    real pushes[TOGETHER(FACES)][WIDE] ALIGNED;
#if LANES == 1
    memset(pushes, 0, sizeof pushes);
#define X(face, a, b, c, d, fourth) measure_face(m, wet, a, b, c, d, fourth, &faces[face]);
    FACE_LIST(X)
#undef X
    for (int f = 0; f < LONG(FACES); f++) push(m, f, &faces[f], pushes[f]);
#define X(face, a, b, c, d, fourth) share(a, b, c, d, fourth, pushes[face], force);
    FACE_LIST(X)
#undef X
#else
#define X(face, a, b, c, d, fourth)                  \
    measure_face(m, wet, a, b, c, d, fourth, faces); \
    push(m, face, faces, *pushes);                   \
    share(a, b, c, d, fourth, *pushes, force);
    FACE_LIST(X)
#undef X
#endif
#else
    (void)m, (void)wet, (void)force;
#endif
}

/* Drag, weight, ground and external forces, mass point by mass point. */
INLINE void set_point_forces(const BodyState *m, real wet[POINTS][LANES], Forces force) {
    (void)wet;
    for (int i = 0; i < POINTS; i++)
        EACH_LANE {
#ifdef SURFACE
            const real immersed = wet[i][l];
#else
            const real immersed = 1;
#endif
            point_force(
                m->positions[i] + l, m->velocities[i] + l, POINT(mass, MASS, i), LIFT[i], immersed WATER(drag), force[i] + l
            );
#define X(axis, number, newtons) force[i][(axis) * AXIS + l] += MASS[i] * (real)(newtons) * m->controls[number][l];
            FORCE_LIST(X)
#undef X
        }
}

INLINE void find_forces(const BodyState *m, Forces force, Springs stiffness) {
    real wet[POINTS][LANES] ALIGNED;
    memset(force, 0, sizeof(Forces));
    soak(m, wet);
    set_point_forces(m, wet, force);
    add_springs(m, stiffness, force);
    add_faces(m, wet, force);
}

/* Activations approach their controls: `remaining` of the difference is left. */
INLINE void activate(const BodyState *from, real remaining, BodyState *to) {
    for (int i = 0; i < MUSCLES; i++)
        EACH_LANE to->activations[i][l] = from->controls[i][l] + (from->activations[i][l] - from->controls[i][l]) * remaining;
}

static double remaining_after(double seconds) { return TIME_CONSTANT > 0 ? exp(-seconds / (TIME_CONSTANT > 0 ? TIME_CONSTANT : 1)) : 0; }

static void run_symplectic(BodyState *m, long steps, double dt) {
    const real h = (real)dt, remaining = (real)remaining_after(dt);
    for (long step = 0; step < steps; step++) {
        Forces force;
        Springs stiffness;
        find_forces(m, force, stiffness);
        for (int i = 0; i < POINTS; i++)
            EACH_PART {
                VECTOR(m->velocities, i) += VECTOR(force, i) * (h * POINT_PART(lightness, LIGHTNESS, i));
                VECTOR(m->positions, i) += VECTOR(m->velocities, i) * h;
            }
        activate(m, remaining, m);
    }
}

/* Factor the matrix into L D L' (Cholesky's without roots) and solve for three axes; only the fill-in is touched. */
INLINE void solve(real matrix[ENTRIES][LANES], Forces right) {
    real inverse[POINTS][LANES] ALIGNED, factor[ENTRIES][LANES] ALIGNED;
#define PIVOT(k, kk) EACH_LANE inverse[k][l] = 1 / matrix[kk][l];
#define COLUMN(i, k, ik)                                          \
    EACH_LANE factor[ik][l] = matrix[ik][l] * inverse[k][l];      \
    EACH_PART VECTOR(right, i) -= SPREAD(factor[ik]) * VECTOR(right, k);
#define UPDATE(ij, ik, jk) EACH_LANE matrix[ij][l] -= factor[ik][l] * matrix[jk][l];
#define SCALE(k) EACH_PART VECTOR(right, k) *= SPREAD(inverse[k]);
#define BACK(i, k, ik) EACH_PART VECTOR(right, k) -= SPREAD(factor[ik]) * VECTOR(right, i);
    ELIMINATE
}

static void run_semi_implicit(BodyState *m, long steps, double dt) {
    const real h = (real)dt, remaining = (real)remaining_after(dt), rate = (real)(1 / dt);
    for (long step = 0; step < steps; step++) {
        Forces force;
        Springs stiffness;
        real matrix[ENTRIES][LANES] ALIGNED;
        find_forces(m, force, stiffness);
        memset(matrix, 0, sizeof matrix);
        for (int s = 0; s < SPRINGS; s++) EACH_LANE stiffness[s][l] = h * larger(stiffness[s][l], 0);
#define X(point, at) EACH_LANE matrix[at][l] = rate * POINT(mass, MASS, point);
        DIAGONAL_LIST(X)
#undef X
#define X(spring, aa, bb, ab)                  \
    EACH_LANE {                                \
        matrix[aa][l] += stiffness[spring][l]; \
        matrix[bb][l] += stiffness[spring][l]; \
        matrix[ab][l] -= stiffness[spring][l]; \
    }
        MATRIX_LIST(X)
#undef X
        for (int i = 0; i < POINTS; i++) EACH_PART VECTOR(force, i) += VECTOR(m->velocities, i) * (rate * POINT_PART(mass, MASS, i));
        solve(matrix, force);
        for (int i = 0; i < POINTS; i++)
            EACH_PART {
                VECTOR(m->velocities, i) = VECTOR(force, i);
                VECTOR(m->positions, i) += VECTOR(force, i) * h;
            }
        activate(m, remaining, m);
    }
}

/* One of the four derivatives: the `force` a time `h` along the one before; they are summed with `weight`,
   those of positions in `moved`, those of velocities in `gained`. */
static void add_slope(const BodyState *m, BodyState *at, real h, real weight, Forces force, Forces moved, Forces gained) {
    Springs stiffness;
    for (int i = 0; i < POINTS; i++)
        EACH_PART {
            vector ahead = VECTOR(m->velocities, i) + VECTOR(force, i) * (h * POINT_PART(lightness, LIGHTNESS, i));
            VECTOR(at->positions, i) = VECTOR(m->positions, i) + VECTOR(at->velocities, i) * h;
            VECTOR(at->velocities, i) = ahead;
        }
    find_forces(at, force, stiffness);
    for (int i = 0; i < POINTS; i++)
        EACH_PART {
            VECTOR(moved, i) += VECTOR(at->velocities, i) * weight;
            VECTOR(gained, i) += VECTOR(force, i) * (weight * POINT_PART(lightness, LIGHTNESS, i));
        }
}

static void run_rk4(BodyState *m, long steps, double dt) {
    const real h = (real)dt, half = (real)remaining_after(dt / 2), remaining = (real)remaining_after(dt);
    for (long step = 0; step < steps; step++) {
        Forces force, moved, gained;
        BodyState at = *m;
        memset(force, 0, sizeof force);
        memset(moved, 0, sizeof moved);
        memset(gained, 0, sizeof gained);
        add_slope(m, &at, 0, h / 6, force, moved, gained);
        activate(m, half, &at);
        add_slope(m, &at, h / 2, h / 3, force, moved, gained);
        add_slope(m, &at, h / 2, h / 3, force, moved, gained);
        activate(m, remaining, &at);
        add_slope(m, &at, h, h / 6, force, moved, gained);
        for (int i = 0; i < POINTS; i++)
            EACH_PART {
                VECTOR(m->positions, i) += VECTOR(moved, i);
                VECTOR(m->velocities, i) += VECTOR(gained, i);
            }
        activate(m, remaining, m);
    }
}

#if PARAMETERS
/* The numbers of the bodies with these parameters. */
static void set_numbers(const BodyState *m, Numbers *numbers) {
    memset(numbers, 0, sizeof *numbers);
    for (int s = 0; s < SPRINGS; s++)
        EACH_LANE {
            real spring[WIDE];
            spring_numbers(
                ALONG[s], ACROSS[s], FORCE_DENSITY[s], GROUP_STIFFNESS(s), GROUP_DAMPING(s), STIFFNESS_FACTOR, DAMPING_FACTOR,
                GROWTH, DENSITY, spring
            );
            numbers->stiffness[s][l] = spring[0];
            numbers->damping[s][l] = spring[AXIS];
            numbers->length[s][l] = spring[2 * AXIS];
        }
    for (int i = 0; i < POINTS; i++)
        EACH_LANE {
            numbers->mass[i][l] = mass_of_point(MASS[i], GROWTH, DENSITY);
            numbers->lightness[i][l] = 1 / numbers->mass[i][l];
        }
    EACH_LANE {
        numbers->face_drag[l] = FACE_DRAG;
        numbers->drag[l] = DRAG;
    }
}
#endif

/* A state is every position, every velocity, every activation, every parameter, each LANES times. */
static void read_state(const real *state, BodyState *m, Numbers *numbers) {
    memset(m, 0, sizeof *m);
    for (int i = 0; i < POINTS; i++)
        for (int axis = 0; axis < 3; axis++)
            EACH_LANE {
                m->positions[i][axis * AXIS + l] = state[(3 * i + axis) * LANES + l];
                m->velocities[i][axis * AXIS + l] = state[(3 * (POINTS + i) + axis) * LANES + l];
            }
    for (int i = 0; i < MUSCLES; i++) EACH_LANE m->activations[i][l] = state[(6 * POINTS + i) * LANES + l];
#if PARAMETERS
    for (int i = 0; i < PARAMETERS; i++) EACH_LANE m->parameters[i][l] = state[(6 * POINTS + MUSCLES + i) * LANES + l];
    set_numbers(m, numbers);
    m->numbers = numbers;
#else
    (void)numbers;
#endif
}

static void write_state(const BodyState *m, real *state) {
    for (int i = 0; i < POINTS; i++)
        for (int axis = 0; axis < 3; axis++)
            EACH_LANE {
                state[(3 * i + axis) * LANES + l] = m->positions[i][axis * AXIS + l];
                state[(3 * (POINTS + i) + axis) * LANES + l] = m->velocities[i][axis * AXIS + l];
            }
    for (int i = 0; i < MUSCLES; i++) EACH_LANE state[(6 * POINTS + i) * LANES + l] = m->activations[i][l];
    for (int i = 0; i < PARAMETERS; i++) EACH_LANE state[(6 * POINTS + MUSCLES + i) * LANES + l] = m->parameters[i][l];
}

static void run(int integrator, BodyState *m, long steps, double dt) {
    (integrator == 0 ? run_symplectic : integrator == 1 ? run_semi_implicit : run_rk4)(m, steps, dt);
}

static void hold(BodyState *m, const real *controls) { memcpy(m->controls, controls, CONTROLS * LANES * sizeof(real)); }

/* Write the states of `groups` bodies, or lanes of them, after each of `count` controls, each held for `steps` steps of `dt`. */
void play(int integrator, long groups, long count, long steps, double dt, const real *starts, const real *controls, real *states) {
    for (long g = 0; g < groups; g++) {
        Numbers numbers ALIGNED;
        BodyState m ALIGNED;
        read_state(starts + g * STATE * LANES, &m, &numbers);
        for (long t = g * count; t < (g + 1) * count; t++) {
            hold(&m, controls + t * CONTROLS * LANES);
            run(integrator, &m, steps, dt);
            write_state(&m, states + t * STATE * LANES);
        }
    }
}
