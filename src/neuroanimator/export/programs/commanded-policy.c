@NAME@_API void @name@_control(const float *state, const float *command, float *control, float *commanded_state) {
    @name@_answer(@name@_k, state, command, control, commanded_state);
}
