"""The event loop: from a model and a launch to the whole motion, in exact legs between exactly timed events."""

import dataclasses
import math

import numpy as np

from synthcam.dynamics.contacts.calendar import ContactDistances, EventCalendar
from synthcam.dynamics.contacts.contact_time import MIN_IMPACT_SPEED_M_S, STAYING
from synthcam.dynamics.contacts.impact import MIN_BOUNCE_SPEED_M_S, collide_pair, hit_wall, land_on_plate
from synthcam.dynamics.contacts.lasting import STICKING_M_S, TouchingBodies
from synthcam.dynamics.contacts.sticking import StickingBodies
from synthcam.dynamics.forces import (
    LAWS,
    NOWHERE,
    ROLL,
    SLIDE,
    ZERO_SPEED_M_S,
    BallStates,
    classify_modes,
    find_ending_slip,
)
from synthcam.dynamics.interacting_pair import CANNOT_REST, LEAD_TIME_S, InteractingPair, make_leg, make_start_event
from synthcam.dynamics.kinematics import (
    TOUCH_TOLERANCE,
    State,
    slip_rate,
    slip_velocity,
    stop_time,
    to_rest,
    to_rolling,
)
from synthcam.dynamics.launch import LaterLaunch, Launch
from synthcam.dynamics.propagate import MAX_SPEED_M_S, propagate, propagate_back
from synthcam.dynamics.start_from_rest import MIN_IMPACT_SPEED_OF_PAIR_M_S, excess_push
from synthcam.dynamics.supports import Support
from synthcam.dynamics.tabletop import ImpactChanges, Table
from synthcam.dynamics.trajectory import (
    CarriedLeg,
    Event,
    FlightLeg,
    Leg,
    NumericLeg,
    PushLeg,
    RestLeg,
    RollLeg,
    SlideLeg,
    Trajectory,
)
from synthcam.model import Bodies, Model
from synthcam_shared.arrays import Array

PLATE = Table()
MAX_TIME_S = 1e4  # beyond it the last bit of a time is too coarse for an event
MAX_PAIR_TIME_S = 60.0  # of balls that push each other, which are integrated in small steps


def solve(
    model: Model,
    launch: Launch,
    start: float = 0.0,
    end: float = 0.0,
    finish_slides: bool = True,
    table: Table = PLATE,
    max_events: int = 10_000_000,
) -> Trajectory:
    """Solve the motion of a launch from `start` to `end`, s; with `finish_slides` beyond, until the last slide has
    ended.

    Legs are closed forms where no active effect changes their laws, and numerical solutions elsewhere.

    Impacts take no time, so balls that lose energy may collide ever faster, without end. The contact duration of a
    table bounds this. A ball that hits within this time of its last impact loses no energy, as in the model of
    S. Luding and S. McNamara, Granular Matter 1 (1998) 113. Balls that are pressed together part at gravity times half
    of it. With a duration of 0 such a sequence is an error.

    Balls that touch several others at once hit them one after the other, in the order of their numbers. So momentum is
    conserved, and a row of equal balls passes on an impact as Newton's cradle does.

    Raises ValueError if balls overlap, if a ball that should be at rest cannot stay there, or if a slide or the motion
    never ends. It also does beyond MAX_SPEED_M_S, MAX_TIME_S, and MAX_PAIR_TIME_S for balls that push each other.
    """
    for what, t in (("its launch", launch.time), ("its start", start), ("its end", end)):
        if not abs(t) <= MAX_TIME_S:
            raise ValueError(f"{what} is at {t:g} s: a motion is solved within {MAX_TIME_S:g} s of 0")
    if model.laws.needs("push", "other"):
        lasts = max(launch.time, end) - min(launch.time, start)
        if len(launch.states) > 2:
            raise ValueError(f"balls that push each other are modelled in twos, not {len(launch.states)} at a time")
        if lasts > MAX_PAIR_TIME_S:
            raise ValueError(f"balls that push each other are followed for {MAX_PAIR_TIME_S:g} s, not for {lasts:g} s")
    return _EventLoop(model, launch, start, end, finish_slides, table).motion(max_events)


class _EventLoop:
    """One run of the event loop; states are nine floats. Balls that push each other are solved together."""

    def __init__(
        self, model: Model, launch: Launch, start: float, end: float, finish_slides: bool, table: Table
    ) -> None:
        self.model, self.bodies, self.end, self.finish_slides = model, launch.bodies, end, finish_slides
        self.radius, self.inertia = launch.bodies.radius.tolist(), launch.bodies.inertia.tolist()
        self.own = list(zip(self.radius, launch.bodies.mass.tolist(), self.inertia, strict=True))
        self.flying_height = [radius * (1 + TOUCH_TOLERANCE) for radius in self.radius]  # of centres: these are lower
        self.supports: list[Support | None] = list(table.supports or (None,) * len(self.radius))
        self.start, self.t = start, launch.time
        self.table = table
        changed = table.scatter.active or table.plate_share or table.contact_duration
        self.changes = ImpactChanges(table, model.gravity) if changed else None
        self.events: list[Event] = []
        self.rolled: set[int] = set()  # balls whose slide ended at a bounce: slip in a flight is not a slide
        laws = model.laws
        self.slides, self.rolls = laws.has_effect_on(*LAWS[SLIDE]), laws.has_effect_on(*LAWS[ROLL])  # no closed form
        self.pushes, self.drills = laws.has_effect_on("push"), laws.has_effect_on("drilling")
        mutual = laws.needs("push", "other") and len(launch.states) == 2
        self.pairing = InteractingPair(model, launch.bodies, start, end) if mutual else None
        self.joint: StickingBodies | TouchingBodies | None = None  # bodies that do not move alone
        if any(table.sticks):
            self.joint = StickingBodies(model, launch.bodies, table.sticks)
        elif table.spring:
            self.joint = TouchingBodies(model, launch.bodies, table.spring)
        self.later = launch.later
        self.pushed: dict[int, LaterLaunch] = {}
        self.stretches = [0] * len(self.radius)
        states = {k: tuple(row) for k, row in enumerate(launch.states.tolist())}
        for k in range(len(table.supports)):
            self._start_stretch(k, states[k])
        self.past: list[list[Leg]] = [[] for _ in states]
        if self.pairing:
            states, self.past, self.events = self.pairing.solve_past(launch)
        elif start < launch.time:
            self.past = [self._past_legs(k, states[k], launch.time) for k in states]
        width, seed = table.scatter.distance, table.scatter.seed
        distances = ContactDistances(width, seed) if width else None
        self.calendar = EventCalendar(self.radius, table.walls, max(end, self.t), distances)
        self.legs: list[Leg] = []
        self.unsettled: set[int] = set()  # balls that slide or fly
        self._start_legs(states)
        for number, one in enumerate(self.later):
            self.calendar.schedule(one.time, number)

    def motion(self, max_events: int) -> Trajectory:
        """Run to the end. Raises ValueError after `max_events`: the motion does not settle."""
        for _ in range(max_events):
            due = self.calendar.pop(math.inf if self.finish_slides and self.unsettled else max(self.end, self.t))
            if due is None:
                break
            self.t, _, kind, i, j, _, _ = due
            if kind == "contact":
                self._collide(i, j)
            elif kind == "wall":
                self._bounce(i, j)
            elif kind == "renewal":
                self._start_legs({})
            elif kind == "launch":
                self._launch(self.later[i])
            else:
                self._end_leg(i)
        else:
            raise ValueError(f"the motion does not settle: {max_events} events by {self.t:g} s")
        self.t = max(self.t, self.end)
        for k in range(len(self.legs)):
            self._archive_leg(k)
        return Trajectory(self.start, self.t, tuple(tuple(x) for x in self.past), tuple(self.events))

    def _start_legs(self, states: dict[int, State]) -> None:
        """Start new legs of these balls, and of those that they push."""
        restarted, until = states, math.inf
        joint: dict[int, Leg] = {}
        if self.legs:
            if self.pairing:
                states = {k: self.legs[k].now(self.t) for k in (0, 1)} | states
            elif self.joint:
                states = self._gather(*states) | states
                joint = self.joint.legs(states, self.supports, self.t)
                self.calendar.joined = self.joint.joined
            for k in states:
                self._archive_leg(k)
        if self.pairing:
            legs, until, started = self.pairing.next_legs(states, self.t, tuple(restarted))
            self.events += started
        else:
            legs = [joint.get(k) or self._next_leg(k, state, self.t) for k, state in states.items()]
        if not self.legs:
            self.legs = [*legs]
        for k, leg in zip(states, legs, strict=True):
            self.legs[k] = leg
            if leg.motion in ("slide", "fly"):
                self.unsettled.add(k)
            else:
                self.unsettled.discard(k)
        self.calendar.renew(self.legs, states, self.t, until)

    def _archive_leg(self, k: int) -> None:
        """Move the present leg of a ball to its past; a rest that continued stays one leg."""
        leg, past = self.legs[k], self.past[k]
        leg.t1 = self.t
        if type(leg) is RestLeg and past and isinstance(past[-1], RestLeg) and leg.state == past[-1].state:
            past[-1].t1 = self.t
        else:
            past.append(leg)

    # legs

    def _body(self, k: int) -> Bodies:
        return self.bodies[k : k + 1]

    def _past_legs(self, k: int, state: State, time: float) -> list[Leg]:
        """Make the legs that lead to a launch: the ball rolled, slid all the time, or was at rest."""
        if (support := self.supports[k]) is not None:
            leg = support.leg(state, self.radius[k], time)
            if isinstance(leg, NumericLeg):
                raise ValueError("a disc that slides at its launch has no past: start the run at the launch")
            leg.t0, leg.t1 = self.start, time
            return [leg]
        if state[5] != 0:
            raise ValueError("a ball that flies at its launch has no past: start the run at the launch")
        slip, speed = math.hypot(*slip_velocity(state, self.radius[k])), math.hypot(state[3], state[4])
        slides = slip > ZERO_SPEED_M_S
        if not slides and speed <= ZERO_SPEED_M_S:
            still = to_rest(state, self.radius[k])
            if self._excess(k, still) > 0:
                raise ValueError(CANNOT_REST)
            return [RestLeg(self.start, time, still)]
        if not (self.slides if slides else self.rolls):
            legs = [self._slide(k, state, time, slip) if slides else self._roll(k, state, time, speed, self.start)]
            legs[0].t0, legs[0].t1 = self.start, time
        else:
            span = np.array([self.start - time])
            ball = BallStates.without_drilling(self.model, self._body(k), np.array([state]))
            motions = (motion for _, motion in propagate_back(ball, 0 * span, span))
            legs = [make_leg(motion, 0, SLIDE if slides else ROLL, time) for motion in motions][::-1]
        try:
            speed = math.hypot(*legs[0].now(self.start)[3:5])
        except OverflowError:
            speed = math.inf
        if not speed <= MAX_SPEED_M_S:
            earlier = f"{MAX_SPEED_M_S:g} m/s, {time - self.start:g} s earlier"
            raise ValueError(f"a ball would have had to come faster than {earlier}")
        return legs

    def _next_leg(self, k: int, state: State, t: float) -> Leg:
        """Make the leg of a ball in this state at t, up to its own next event."""
        radius, support = self.radius[k], self.supports[k]
        if self.pushed and (hand := self.pushed.get(k)) is not None:
            rolling = radius if support is None else math.inf
            return PushLeg(t, hand.until, t, state, hand.acceleration, rolling)
        if support is not None:
            return support.leg(state, radius, t)
        if state[5] > 0 or state[2] > self.flying_height[k]:
            gravity, up, height = self.model.gravity, state[5], max(state[2] - radius, 0.0)
            lasts = (up + math.sqrt(up * up + 2 * gravity * height)) / gravity
            flight = FlightLeg(t, t + lasts, t, state, gravity)
            return self._integrate_leg(k, state, t, lasts) if self.pushes else flight
        if (slip := math.hypot(*slip_velocity(state, radius))) > ZERO_SPEED_M_S:
            return self._slide(k, state, t, slip)
        if (speed := math.hypot(state[3], state[4])) > ZERO_SPEED_M_S:
            return self._roll(k, state, t, speed, max(self.end, t) + LEAD_TIME_S)
        still = to_rest(state, radius)
        return RestLeg(t, t if self._excess(k, still) > 0 else math.inf, still)

    def _slide(self, k: int, state: State, t: float, slip: float) -> Leg:
        if not self.slides:
            slowing = self.model.sliding_friction * self.model.gravity
            if slowing == 0:
                raise ValueError("sliding friction does not end the slide: there is none")
            lasts = slip / (slip_rate(self.inertia[k]) * slowing)
            return SlideLeg(t, t + lasts, t, state, self.radius[k], slowing, self.inertia[k])
        floor = find_ending_slip(self.model, np.array([state]), self._body(k)) if self.drills else np.full(1, math.inf)
        return self._integrate_leg(k, state, t, math.inf, floor)

    def _roll(self, k: int, state: State, t: float, speed: float, until: float) -> Leg:
        model = self.model
        if not self.rolls:
            stop = t + stop_time(speed, model.rolling_drag, model.rolling_decel)
            return RollLeg(t, stop, t, state, self.radius[k], model.rolling_drag, model.rolling_decel)
        return self._integrate_leg(k, state, t, until - t)

    def _integrate_leg(self, k: int, state: State, t: float, goal: float, floor: Array | None = None) -> Leg:
        """Integrate a leg without closed form, or as much of it as one step covers."""
        row = np.array([state])
        floor = np.full(1, math.inf) if floor is None else floor
        ((_, step),) = propagate(BallStates(self.model, self._body(k), row, floor), np.array([goal]))
        return make_leg(step.motion, 0, int(classify_modes(row, self._body(k).radius)[0]), t)

    def _excess(self, k: int, state: State) -> float:
        """By how much 5/7 of the push on a ball at rest exceeds what holds it, m/s^2."""
        if not self.pushes:
            return -self.model.rolling_decel
        return float(excess_push(self.model, self._body(k), np.array([state]), NOWHERE[:, None, None])[0, 0])

    # events

    def _end_leg(self, k: int) -> None:
        """The end of a leg: of a slide, a roll, a rest, a flight; no event where a numerical roll was solved to."""
        leg, radius = self.legs[k], self.radius[k]
        before = leg.now(leg.t1)
        if self.joint and (self.joint.find_fellows(k) - {k} or isinstance(leg, CarriedLeg)):
            self._end_joint_legs(k)
        elif leg.motion == "push":
            self._part({k: before})
        elif leg.motion == "roll" and math.hypot(before[3], before[4]) > ZERO_SPEED_M_S:
            self._start_legs({k: before})
        elif leg.motion == "fly":
            self._start_legs({k: self._land(k, before)})
        elif leg.motion == "rest":
            started = [] if self.pairing else [make_start_event(self.model, self._body(k), k, before, self.t, NOWHERE)]
            self.events += started  # a pair has recorded its own
            self._start_legs({e.i: tuple(np.asarray(e.after)[0].tolist()) for e in started})
        elif leg.motion == "slide":
            self._record_event("slide_end", k, before, _end_slip(before, radius, self.inertia[k]))
        else:
            self._record_event("stop", k, before, to_rest(before, radius))

    def _land(self, k: int, before: State) -> State:
        radius = self.radius[k]
        down = np.array([(*before[:2], radius, *before[3:])])
        up = land_on_plate(self.model, down, self._body(k))
        after: State = tuple(up[0].tolist())
        slips = [math.hypot(*slip_velocity(s, radius)) for s in (before, after)]
        self.events.append(Event(self.t, "land", k, before=down, after=up))
        if slips[0] > ZERO_SPEED_M_S and slips[1] <= 1e-9 * slips[0]:
            after = _end_slip(after, radius, self.inertia[k])
            if k not in self.rolled:
                self.events.append(Event(self.t, "slide_end", k, before=down, after=np.array([after])))
            self.rolled.add(k)
        return after

    def _record_event(self, kind: str, k: int, before: State, after: State) -> None:
        rows = np.array([before]), np.array([after])
        self.events.append(Event(self.t, kind, k, -1, *rows))  # type: ignore[arg-type]
        self._start_legs({k: after})

    def _collide(self, i: int, j: int) -> None:
        t = self.t
        states = {i: self.legs[i].now(t), j: self.legs[j].now(t)}
        if math.hypot(*states[i][3:5]) > math.hypot(*states[j][3:5]):
            i, j = j, i  # the slower ball is the target
        change, lasts = None, isinstance(self.joint, TouchingBodies)
        if self.changes:
            further = math.dist(states[i][:3], states[j][:3]) - (self.radius[i] + self.radius[j])
            change = self.changes.draw(t, (i, j), further, lasts)
        if self.calendar.distances:
            self.calendar.distances.renew(i, j)
        if isinstance(self.joint, StickingBodies) and self.joint.concerns(i, j):
            events, new = self.joint.collide(t, i, j, self._gather(i, j), change)
            self.events += events
            self._part(new)
            return
        if lasts:
            states[j] = _approach(states[i], states[j])
        own = self.own[i], self.own[j]
        target, striker, n, along_n, along_t = collide_pair(self.model, states[i], states[j], *own, change)
        slowest = MIN_IMPACT_SPEED_OF_PAIR_M_S if self.pairing else MIN_IMPACT_SPEED_M_S
        before: Array = np.array((states[i], states[j]))
        drawn = dict(change.drawn) if change else {}
        if drawn:  # a turn that would part the balls is not taken
            x, y = (states[i][axis] - states[j][axis] for axis in (0, 1))
            drawn["normal_turn"] = math.atan2(x * n[1] - y * n[0], x * n[0] + y * n[1])
        if isinstance(self.joint, TouchingBodies):
            impact = (states[i], states[j]), (target, striker), (along_n, along_t)
            self.joint.begin(i, j, *impact, len(self.events))
            self.events.append(Event(t, "contact", i, j, before, n=n[:2], drawn=drawn))
            self._start_legs({k: self.legs[k].now(t) for k in (i, j)})
            return
        if not self.table.contact_duration and along_n < slowest * self.own[i][1]:
            raise ValueError(f"balls {i} and {j} " + STAYING.format(t))
        new = {i: self._settle(i, target), j: self._settle(j, striker)}
        after: Array = np.array((new[i], new[j]))
        self.events.append(Event(t, "contact", i, j, before, after, n[:2], along_n, along_t, drawn))
        self._part(new)

    def _bounce(self, k: int, number: int) -> None:
        wall, change = self.table.walls[number], self.changes.draw(self.t, (k,)) if self.changes else None
        if isinstance(self.joint, StickingBodies) and self.joint.concerns(k):
            events, new = self.joint.bounce(self.t, k, number, wall, self._gather(k), change)
            self.events += events
            self._part(new)
            return
        before = self.legs[k].now(self.t)
        hit = hit_wall(self.model, wall, before, self.own[k], change)
        after = self._settle(k, hit.after)
        rows = np.array([before]), np.array([after])
        self.events.append(Event(self.t, "wall", k, number, *rows, hit.n, hit.impulse_n, hit.impulse_t))
        self._part({k: after})

    def _settle(self, k: int, state: State) -> State:
        """Drop a vertical velocity too small for a bounce, and what would lift or tilt a body that lies flat."""
        if self.supports[k] is not None:
            return (*state[:5], 0.0, 0.0, 0.0, state[8])
        return state if abs(state[5]) >= MIN_BOUNCE_SPEED_M_S else (*state[:5], 0.0, *state[6:])

    def _part(self, states: dict[int, State]) -> None:
        """Start the legs of balls after an impact; those that it presses on the plate land at once."""
        for k, state in states.items():
            self.rolled.discard(k)
            if k in self.pushed:
                del self.pushed[k]
                self.events.append(Event(self.t, "release", k, before=np.array([state]), after=np.array([state])))
            if self.table.supports:
                self._start_stretch(k, state)
            if state[5] < 0 and state[2] <= self.flying_height[k]:
                states[k] = self._land(k, state)
        self._start_legs(states)

    # launches in the course of the run, stretches on air, and bodies that do not move alone

    def _launch(self, launch: LaterLaunch) -> None:
        k = launch.body
        if self.pairing:
            raise ValueError("balls that push each other are launched at one time")
        before = self.legs[k].now(self.t)
        after: State = (*before[:3], *launch.velocity)
        if isinstance(self.joint, StickingBodies):
            self.events += self.joint.part(self.t, [pair for pair in self.joint.bonds if k in pair])
        self.events.append(Event(self.t, "launch", k, before=np.array([before]), after=np.array([after])))
        self._part({k: after})
        if launch.until > self.t:
            self.pushed[k] = launch
            self._start_legs({k: after})

    def _start_stretch(self, k: int, state: State) -> None:
        """Draw what carries a body until its next hit."""
        support = self.supports[k]
        if support is None or math.hypot(state[3], state[4]) == 0:
            return
        rng = np.random.default_rng((*self.table.scatter.seed, k, self.stretches[k]))
        self.supports[k], drawn = support.draw_stretch(rng)
        self.stretches[k] += 1
        if drawn:
            self.events.append(Event(self.t, "stretch", k, drawn=drawn))

    def _gather(self, *balls: int) -> dict[int, State]:
        """Return the present states of these bodies and of all that move with them."""
        assert self.joint
        return {k: self.legs[k].now(self.t) for k in sorted(self.joint.find_fellows(*balls))}

    def _end_joint_legs(self, k: int) -> None:
        """The end of a lasting contact, or of the motion of a group that sticks together."""
        states = self._gather(k)
        if isinstance(self.joint, TouchingBodies):
            for contact in self.joint.finish(k):
                pair = contact.i, contact.j
                for ball in pair:  # one that rolled through the contact still rolls
                    slip = math.hypot(*slip_velocity(states[ball], self.radius[ball]))
                    if self.supports[ball] is None and slip < 2 * STICKING_M_S:
                        states[ball] = _end_slip(states[ball], self.radius[ball], self.inertia[ball])
                after = np.array([states[ball] for ball in pair])
                began = self.events[contact.event]
                along_n, along_t = (part * contact.given / contact.whole for part in contact.impulses)
                filled = dataclasses.replace(began, after=after, impulse_n=along_n, impulse_t=along_t)
                self.events[contact.event] = filled
                self.events.append(Event(self.t, "contact_end", *pair, before=after, after=after))
        elif isinstance(self.joint, StickingBodies):
            before, states = states, self.joint.stop(states, self.supports)
            for ball in states if all(s[8] == 0 for s in states.values()) else ():
                early, late = (np.array([s[ball]]) for s in (before, states))
                self.events.append(Event(self.t, "stop", ball, before=early, after=late))
        self._start_legs(states)


def _approach(target: State, striker: State) -> State:
    """Let balls approach at a speed that shows the law of a contact that begins slowly."""
    least_approach_m_s = 1e-6
    x, y = target[0] - striker[0], target[1] - striker[1]
    far = math.hypot(x, y)
    rate = ((striker[3] - target[3]) * x + (striker[4] - target[4]) * y) / far
    more = max(least_approach_m_s - rate, 0.0) / far
    return (*striker[:3], striker[3] + more * x, striker[4] + more * y, *striker[5:])


def _end_slip(state: State, radius: float, inertia: float) -> State:
    """Let the ball roll as after its slide, with (v + k R w x z)/(1 + k); a vertical velocity stays."""
    (ux, uy), share = slip_velocity(state, radius), 1 / slip_rate(inertia)
    return to_rolling((*state[:3], state[3] - share * ux, state[4] - share * uy, *state[5:]), radius)
