// A school of fish, each with a policy that swims to a place of its own. No drawing here: Node runs it too.

const GROUPS = 6; // take turns, so that every image has the same work
const SPEED = 0.14; // [m/s]

export class School {
  constructor(fish, policy, facts, policyFacts, count) {
    this.policy = policy;
    this.dt = facts.dt;
    this.phasePerStep = policyFacts.phase_per_step;
    this.parts = partsOf(facts.state);
    this.size = facts.rest.length;
    this.controls = facts.control_low.length;
    this.groups = [];
    const spread = Math.sqrt(count) / 8; // half the side of the square they start in [m]
    for (let i = 0; i < GROUPS; i++) {
      const present = Math.floor(count / GROUPS) + (i < count % GROUPS ? 1 : 0);
      this.groups.push(this.group(fish.batch(Math.max(present, 1)), facts.rest, spread, i / GROUPS));
    }
  }

  // A group at rest, at random places and headings; `share` of a super step has gone by.
  group(batch, rest, spread, share) {
    for (let body = 0; body < batch.count; body++) {
      const place = [spread * (2 * Math.random() - 1), spread * (2 * Math.random() - 1)];
      batch.states.set(turned(rest, this.parts.count, 2 * Math.PI * Math.random(), place), body * this.size);
    }
    batch.encode();
    const offsets = Float32Array.from({ length: 2 * batch.count }, () => Math.random() - 0.5);
    return { batch, before: batch.states.slice(), step: 0, waited: share * this.dt, offsets };
  }

  // Let `seconds` go by; every fish swims to about `target` [m].
  advance(seconds, target) {
    for (const group of this.groups) {
      group.waited += Math.min(seconds, this.dt);
      if (group.waited >= this.dt) {
        group.waited -= this.dt;
        this.superStep(group, target);
      }
    }
  }

  superStep(group, target) {
    const { batch, offsets } = group;
    const states = batch.states.slice();
    const phase = (group.step * this.phasePerStep) % (2 * Math.PI);
    for (let body = 0; body < batch.count; body++) {
      const state = states.subarray(body * this.size, (body + 1) * this.size);
      const place = [target[0] + 2 * offsets[2 * body], target[1] + 2 * offsets[2 * body + 1]];
      const control = this.policy.control(state, phase, [SPEED, this.turnTo(state, place), 0, 0]);
      batch.controls.set(control, body * this.controls);
    }
    batch.advance();
    group.before = states;
    group.step += 1;
  }

  // How far a fish still has to turn left [rad].
  turnTo(state, [x, y]) {
    const { nose, tail } = this.parts;
    const ahead = [state[nose] - state[tail], state[nose + 1] - state[tail + 1]];
    const to = [x - state[nose], y - state[nose + 1]];
    return Math.atan2(ahead[0] * to[1] - ahead[1] * to[0], ahead[0] * to[0] + ahead[1] * to[1]);
  }

  // Calls draw(points) for every fish: places [m] along its spine, seen from above, between two super steps.
  forEach(draw) {
    const { spine } = this.parts;
    const points = new Float32Array(2 * spine.length);
    for (const { batch, before, waited } of this.groups) {
      const after = batch.states;
      const share = waited / this.dt;
      for (let body = 0; body < batch.count; body++) {
        spine.forEach((nodes, i) => {
          for (let axis = 0; axis < 2; axis++) {
            let sum = 0;
            for (const node of nodes) {
              const entry = body * this.size + node + axis;
              sum += before[entry] + share * (after[entry] - before[entry]);
            }
            points[2 * i + axis] = sum / nodes.length;
          }
        });
        draw(points);
      }
    }
  }
}

// Where in a state the nose, the tail and the rings of mass points between them begin.
function partsOf(layout) {
  const start = {};
  let entry = 0;
  for (const [name, size] of layout) {
    start[name] = entry;
    entry += size;
  }
  const ring = (name) => ["lu", "ru", "rd", "ld"].map((corner) => start[`${name}_${corner}`]);
  const rings = ["head", "chest", "waist", "loin", "stem"].map(ring);
  return {
    nose: start.nose,
    tail: start.tail_up,
    count: start["nose.velocity"] / 3,
    spine: [[start.nose], ...rings, [start.tail_up, start.tail_down]],
  };
}

// `rest` turned about the vertical by `angle` [rad] and moved; mass points come first, then their velocities.
function turned(rest, count, angle, [x, y]) {
  const state = Float32Array.from(rest);
  const cosine = Math.cos(angle);
  const sine = Math.sin(angle);
  for (let point = 0; point < 2 * count; point++) {
    const isPlace = point < count;
    const a = rest[3 * point];
    const b = rest[3 * point + 1];
    state[3 * point] = cosine * a - sine * b + (isPlace ? x : 0);
    state[3 * point + 1] = sine * a + cosine * b + (isPlace ? y : 0);
  }
  return state;
}
