@NAME@_API void @name@_control(const float *state, float phase, const float *command, float *control) {
    @name@_answer(@name@_k, state, &phase, command, control);
}
