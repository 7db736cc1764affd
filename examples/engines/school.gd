# A school of fish in Godot 4.3 or newer: fish_server, built of fish_server.c, computes it and is asked over a pipe.
extends Node2D

const COUNT := 200
const STATE := 150
const NOSE := 0
const TAIL_UP := 63
const SUPER_STEP := 0.1
const SPEED := 0.14
const PIXELS_PER_METRE := 100.0

var server: Dictionary
var states: PackedFloat32Array
var seconds := 0.0


func _ready() -> void:
	var path := ProjectSettings.globalize_path("res://fish_server")
	server = OS.execute_with_pipe(path, [str(COUNT)])
	if server.is_empty():
		push_error("fish_server could not be started: build it, and put it into the project's folder.")
		set_process(false)
		return
	advance(Vector2.ZERO)


func _process(delta: float) -> void:
	seconds += delta
	if seconds >= SUPER_STEP:
		seconds -= SUPER_STEP
		advance(get_local_mouse_position() / PIXELS_PER_METRE)
		queue_redraw()


# Let every fish swim towards a place [m] for one super step.
func advance(target: Vector2) -> void:
	var commands := PackedFloat32Array()
	commands.resize(COUNT * 4)
	for fish in COUNT:
		commands[4 * fish] = SPEED
		if not states.is_empty():
			commands[4 * fish + 1] = turn_to(fish, target)
	var pipe: FileAccess = server["stdio"]
	pipe.store_buffer(commands.to_byte_array())
	pipe.flush()
	states = read_states(pipe)


func read_states(pipe: FileAccess) -> PackedFloat32Array:
	var bytes := PackedByteArray()
	var wanted := COUNT * STATE * 4
	while bytes.size() < wanted:
		bytes.append_array(pipe.get_buffer(wanted - bytes.size()))
	return bytes.to_float32_array()


# How far the fish still has to turn left [rad].
func turn_to(fish: int, target: Vector2) -> float:
	var nose := place(fish, NOSE)
	var ahead := nose - place(fish, TAIL_UP)
	return ahead.angle_to(target - nose)


# Where a part of a fish is, seen from above [m].
func place(fish: int, part: int) -> Vector2:
	var start := fish * STATE + part
	return Vector2(states[start], states[start + 1])


func _draw() -> void:
	if states.is_empty():
		return
	for fish in COUNT:
		var nose := place(fish, NOSE) * PIXELS_PER_METRE
		var tail := place(fish, TAIL_UP) * PIXELS_PER_METRE
		draw_line(tail, nose, Color.ORANGE, 3.0)


func _exit_tree() -> void:
	if not server.is_empty():
		server["stdio"].close()
