/* A function (numbers, x) -> y and its derivatives, as generated for one program: see `c_map`. */
typedef struct {
    const float *constants, *numbers;
    void (*forward)(const float *k, const float *numbers, const float *x, float *tape, float *tape_of_lanes, float *y);
    void (*backward)(const float *k, const float *tape, const float *tape_of_lanes, const float *of_y, float *of_x);
    void (*push)(const float *k, const float *tape, const float *tape_of_lanes, const float *x, float *y);
    void (*slope)(const float *k, const float *tape, const float *tape_of_lanes, const float *of_y, float *of_x);
    void (*lanes)(const float *k, const float *numbers, const float *x, float *y);
    long inputs, outputs, tape;
} na_map;

/* `y` of `x`, and the tape that the next two need. */
static void map_forward(const na_map *map, const float *x, float *tape, float *y) {
    NA_ALIGNED float nothing[LANES];
    map->forward(map->constants, map->numbers, x, tape, nothing, y);
}

/* Cotangents `of_x` of x for `width` cotangents `of_y` of y: one, or sixteen lanes. */
static void map_backward(const na_map *map, const float *tape, const float *of_y, float *of_x, long width) {
    NA_ALIGNED float nothing[LANES];
    (width == 1 ? map->slope : map->backward)(map->constants, tape, nothing, of_y, of_x);
}

/* Tangents `y`, in lanes, for sixteen tangents `x`. */
static void map_push(const na_map *map, const float *tape, const float *x, float *y) {
    NA_ALIGNED float nothing[LANES];
    map->push(map->constants, tape, nothing, x, y);
}

/* Values `y`, in lanes, of sixteen x. */
static void map_lanes(const na_map *map, const float *x, float *y) {
    map->lanes(map->constants, map->numbers, x, y);
}
