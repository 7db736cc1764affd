@NAME@_API void @name@_control(const float *state, float *control) {
    @name@_answer(@name@_k, state, control);
}
