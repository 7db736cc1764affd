/* The mass-spring loop of physics/deformable/mass_spring.py as one writes it down in C: any body, its springs and faces
   read from tables, symplectic Euler. */

#include <math.h>

typedef struct {
    int points, springs, faces, muscles, external_forces;
    const int *ends;                                          /* (springs, 2) */
    const float *stiffness, *damping, *length;                /* (springs) */
    const int *muscle;                                        /* (springs), -1: none */
    const float *shorten;                                     /* (springs) */
    const float *mass, *inverse, *lift;                       /* (points), one over it; lift over weight */
    const int *corners;                                       /* (faces, 4) */
    const float *share;                                       /* (faces, 4): zero for a triangle's fourth */
    const float *acceleration;                                /* (3, external_forces), by control */
    float face_drag, drag, surface, depth, gravity;           /* of the water; depth 0: water everywhere */
    float ground_stiffness, ground_damping, friction, slip;   /* of the ground; stiffness 0: none */
} Body;

static float wet_of(const Body *b, const float *x) {
    if (b->depth <= 0) return 1;
    float wet = (b->surface - x[2]) / b->depth + 0.5f;
    return wet < 0 ? 0 : wet > 1 ? 1 : wet;
}

static void add_springs(const Body *b, const float *x, const float *v, const float *a, float *f) {
    for (int s = 0; s < b->springs; s++) {
        const int i = 3 * b->ends[2 * s], j = 3 * b->ends[2 * s + 1];
        const float rx = x[j] - x[i], ry = x[j + 1] - x[i + 1], rz = x[j + 2] - x[i + 2];
        const float inverse = 1 / sqrtf(rx * rx + ry * ry + rz * rz + 1e-24f);
        const float rate = (rx * (v[j] - v[i]) + ry * (v[j + 1] - v[i + 1]) + rz * (v[j + 2] - v[i + 2])) * inverse;
        const float rest = b->length[s] * (b->muscle[s] < 0 ? 1 : 1 - b->shorten[s] * a[b->muscle[s]]);
        const float n = b->stiffness[s] + inverse * (b->damping[s] * rate - b->stiffness[s] * rest);
        f[i] += n * rx, f[i + 1] += n * ry, f[i + 2] += n * rz;
        f[j] -= n * rx, f[j + 1] -= n * ry, f[j + 2] -= n * rz;
    }
}

static void add_faces(const Body *b, const float *x, const float *v, float *f) {
    for (int k = 0; k < b->faces; k++) {
        const int *c = b->corners + 4 * k;
        const float *share = b->share + 4 * k;
        const float *p0 = x + 3 * c[0], *p1 = x + 3 * c[1], *p2 = x + 3 * c[2], *p3 = x + 3 * c[3];
        const float ax = p2[0] - p0[0], ay = p2[1] - p0[1], az = p2[2] - p0[2];
        const float bx = p3[0] - p1[0], by = p3[1] - p1[1], bz = p3[2] - p1[2];
        const float nx = (ay * bz - az * by) / 2, ny = (az * bx - ax * bz) / 2, nz = (ax * by - ay * bx) / 2;
        float flow = 0, wet = 0;
        for (int i = 0; i < 4; i++) {
            const float *w = v + 3 * c[i];
            flow += share[i] * (nx * w[0] + ny * w[1] + nz * w[2]);
            wet += share[i] * wet_of(b, x + 3 * c[i]);
        }
        if (flow <= 0) continue;
        const float push = -b->face_drag * flow * wet / sqrtf(nx * nx + ny * ny + nz * nz + 1e-24f);
        for (int i = 0; i < 4; i++) {
            float *g = f + 3 * c[i];
            g[0] += share[i] * push * nx, g[1] += share[i] * push * ny, g[2] += share[i] * push * nz;
        }
    }
}

static void add_outside(const Body *b, const float *x, const float *v, const float *u, float *f) {
    float driven[3] = {0, 0, 0};
    for (int axis = 0; axis < 3; axis++)
        for (int c = 0; c < b->external_forces; c++) driven[axis] += b->acceleration[axis * b->external_forces + c] * u[c];
    for (int i = 0; i < b->points; i++) {
        const float *p = x + 3 * i, *w = v + 3 * i, m = b->mass[i], wet = wet_of(b, p);
        float *g = f + 3 * i;
        for (int axis = 0; axis < 3; axis++) g[axis] += m * (driven[axis] - b->drag * wet * w[axis]);
        g[2] += m * b->gravity * (b->lift[i] * wet - 1);
        if (b->ground_stiffness > 0 && p[2] < 0) {
            const float damped = 1 - b->ground_damping * w[2], up = -b->ground_stiffness * p[2] * (damped > 0 ? damped : 0);
            const float slide = b->friction * up / sqrtf(w[0] * w[0] + w[1] * w[1] + b->slip * b->slip);
            g[0] -= slide * w[0], g[1] -= slide * w[1], g[2] += up;
        }
    }
}

/* Takes `steps` steps of `dt` from the `count` states, each under its controls; `remaining` is how much of an
   activation's difference from its control is left after a step. A state is positions, velocities, activations. */
void plain(const Body *b, int count, int steps, float dt, float remaining, float *states, const float *controls) {
    const int size = 3 * b->points, whole = 2 * size + b->muscles, inputs = b->muscles + b->external_forces;
    float f[size];
    for (int row = 0; row < count; row++) {
        float *x = states + (long)row * whole, *v = x + size, *a = v + size;
        const float *u = controls + (long)row * inputs;
        for (int step = 0; step < steps; step++) {
            for (int i = 0; i < size; i++) f[i] = 0;
            add_springs(b, x, v, a, f);
            add_faces(b, x, v, f);
            if (b->gravity > 0 || b->drag > 0 || b->external_forces) add_outside(b, x, v, u, f);
            for (int i = 0; i < b->points; i++)
                for (int axis = 0; axis < 3; axis++) v[3 * i + axis] += dt * b->inverse[i] * f[3 * i + axis];
            for (int i = 0; i < size; i++) x[i] += dt * v[i];
            for (int i = 0; i < b->muscles; i++) a[i] = u[i] + remaining * (a[i] - u[i]);
        }
    }
}
