//! Motion of one axis with finite speed and acceleration in closed form: segments of constant
//! acceleration, so that a position at any time is computed without time steps.
//! PURE. Uses: nothing. Never: clocks (times are passed in), devices.

use std::ops::RangeInclusive;

/// Speed and accelerations of a motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pace {
    /// Cruising speed, units/s.
    pub speed: f64,
    /// Acceleration, units/s^2.
    pub acceleration: f64,
    /// Deceleration, units/s^2.
    pub deceleration: f64,
}

/// State of an axis from which a motion starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    /// Time of the start, s.
    pub t_s: f64,
    /// Position, mm; deg for the rotary axis.
    pub position: f64,
    /// Velocity, units/s.
    pub velocity: f64,
}

/// A segment of constant acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stretch {
    from_s: f64,
    position: f64,
    velocity: f64,
    acceleration: f64,
}

impl Stretch {
    fn position(&self, t_s: f64) -> f64 {
        let dt = t_s - self.from_s;
        self.position + dt * (self.velocity + 0.5 * self.acceleration * dt)
    }

    fn velocity(&self, t_s: f64) -> f64 {
        self.velocity + self.acceleration * (t_s - self.from_s)
    }
}

/// A trajectory that ends at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    stretches: Vec<Stretch>,
    end_s: f64,
    target: f64,
}

impl Trajectory {
    /// Creates a trajectory that is always at rest.
    pub fn at_rest(position: f64) -> Self {
        Self { stretches: Vec::new(), end_s: f64::NEG_INFINITY, target: position }
    }

    /// Creates a trajectory to rest at `target`. A target that can no longer be reached without
    /// reversing is overrun, as by a drive.
    pub fn to_target(start: Start, target: f64, pace: Pace) -> Self {
        let Start { t_s, position, velocity } = start;
        let mut path = Self { stretches: Vec::with_capacity(4), end_s: t_s, target: position };
        let braking = velocity * velocity.abs() / (2.0 * pace.deceleration);
        let beyond_stop = target - (position + braking);
        if velocity != 0.0 && beyond_stop * velocity < 0.0 {
            path.brake_from(velocity, pace.deceleration);
            path.run_to(0.0, target, pace);
        } else {
            path.run_to(velocity, target, pace);
        }
        path.target = target;
        path
    }

    /// Creates a trajectory to rest as soon as possible.
    pub fn to_stand(start: Start, deceleration: f64) -> Self {
        let Start { t_s, position, velocity } = start;
        let mut path = Self { stretches: Vec::with_capacity(1), end_s: t_s, target: position };
        path.brake_from(velocity, deceleration);
        path
    }

    /// Position at a time not before the start, units.
    pub fn position(&self, t_s: f64) -> f64 {
        if t_s >= self.end_s {
            return self.target;
        }
        self.stretch_at(t_s).map_or(self.target, |s| s.position(t_s))
    }

    /// Velocity at a time not before the start, units/s.
    pub fn velocity(&self, t_s: f64) -> f64 {
        if t_s >= self.end_s {
            return 0.0;
        }
        self.stretch_at(t_s).map_or(0.0, |s| s.velocity(t_s))
    }

    /// Whether the axis moves at a time.
    pub fn moving(&self, t_s: f64) -> bool {
        t_s < self.end_s
    }

    /// Time at which it comes to rest, s.
    pub fn end_s(&self) -> f64 {
        self.end_s
    }

    /// Position at which it comes to rest, units.
    pub fn target(&self) -> f64 {
        self.target
    }

    /// Smallest and largest position in an interval of time, s; units.
    pub fn range(&self, times_s: RangeInclusive<f64>) -> [f64; 2] {
        let (from_s, to_s) = times_s.into_inner();
        let (a, b) = (self.position(from_s), self.position(to_s));
        let mut range = [a.min(b), a.max(b)];
        for s in &self.stretches {
            if s.acceleration != 0.0 {
                let turn_s = s.from_s - s.velocity / s.acceleration;
                if from_s < turn_s && turn_s < to_s && turn_s < self.end_s {
                    let p = self.position(turn_s);
                    range = [range[0].min(p), range[1].max(p)];
                }
            }
        }
        range
    }

    fn stretch_at(&self, t_s: f64) -> Option<&Stretch> {
        self.stretches.iter().rev().find(|s| s.from_s <= t_s).or(self.stretches.first())
    }

    /// Appends a segment that lasts `dt_s` from the present end.
    fn push(&mut self, velocity: f64, acceleration: f64, dt_s: f64) {
        if dt_s <= 0.0 {
            return;
        }
        let s = Stretch { from_s: self.end_s, position: self.target, velocity, acceleration };
        self.end_s += dt_s;
        self.target = s.position(self.end_s);
        self.stretches.push(s);
    }

    fn brake_from(&mut self, velocity: f64, deceleration: f64) {
        self.push(velocity, -deceleration.copysign(velocity), velocity.abs() / deceleration);
    }

    /// Appends a motion from the present end, whose velocity does not change its sign.
    fn run_to(&mut self, velocity: f64, target: f64, pace: Pace) {
        let way = target - self.target;
        let sign = if way == 0.0 { velocity.signum() } else { way.signum() };
        let (distance, v0) = (way.abs(), velocity.abs());
        let (a, d) = (pace.acceleration, pace.deceleration);
        let peak = ((distance + v0 * v0 / (2.0 * a)) / (0.5 / a + 0.5 / d)).sqrt();
        let v1 = if peak > pace.speed { pace.speed } else { peak.max(v0) };
        let change = if v1 >= v0 { a } else { d };
        let changing = (v1 * v1 - v0 * v0).abs() / (2.0 * change);
        let cruising = distance - changing - v1 * v1 / (2.0 * d);
        self.push(sign * v0, sign * (v1 - v0).signum() * change, (v1 - v0).abs() / change);
        if v1 > 0.0 {
            self.push(sign * v1, 0.0, cruising / v1);
        }
        self.push(sign * v1, -sign * d, v1 / d);
        self.target = target;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PACE: Pace = Pace { speed: 250.0, acceleration: 1500.0, deceleration: 1000.0 };

    #[test]
    fn a_long_move_takes_the_textbook_time() {
        let pace = Pace { speed: 250.0, acceleration: 1500.0, deceleration: 1500.0 };
        let start = Start { t_s: 10.0, position: 0.0, velocity: 0.0 };
        let path = Trajectory::to_target(start, 500.0, pace);
        assert!((path.end_s() - 10.0 - (500.0 / 250.0 + 250.0 / 1500.0)).abs() < 1e-9);
    }

    #[test]
    fn a_stop_covers_the_braking_distance() {
        let start = Start { t_s: 0.0, position: 100.0, velocity: -60.0 };
        let path = Trajectory::to_stand(start, 1000.0);
        assert!((path.target() - (100.0 - 1.8)).abs() < 1e-9);
        assert!((path.end_s() - 0.06).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn motion_is_continuous_within_its_pace_and_arrives(
            start in -500.0..500.0f64, target in -500.0..500.0f64,
            velocity in -300.0..300.0f64, speed in 1.0..300.0f64,
        ) {
            let pace = Pace { speed, ..PACE };
            let from = Start { t_s: 5.0, position: start, velocity };
            let path = Trajectory::to_target(from, target, pace);
            prop_assert!((path.position(5.0) - start).abs() < 1e-6);
            prop_assert!((path.position(path.end_s() - 1e-9) - target).abs() < 1e-4);
            prop_assert_eq!(path.position(path.end_s()), target);
            let dt = 1e-3;
            let top = speed.max(velocity.abs()) + 1e-6;
            let steps = ((path.end_s() - 5.0) / dt) as usize;
            for i in 0..steps.min(4000) {
                let t = 5.0 + i as f64 * dt;
                let (v0, v1) = (path.velocity(t), path.velocity(t + dt));
                prop_assert!(v0.abs() <= top, "speed {} at {}", v0, t);
                prop_assert!((v1 - v0).abs() <= 1500.0 * dt + 1e-6, "jump at {}", t);
                let step = path.position(t + dt) - path.position(t);
                prop_assert!((step - 0.5 * (v0 + v1) * dt).abs() < 1500.0 * dt * dt + 1e-6);
            }
        }

        #[test]
        fn the_range_holds_every_position(
            start in -50.0..50.0f64, target in -50.0..50.0f64, velocity in -300.0..300.0f64,
        ) {
            let from = Start { t_s: 0.0, position: start, velocity };
            let path = Trajectory::to_target(from, target, PACE);
            let [low, high] = path.range(0.0..=path.end_s());
            for i in 0..200 {
                let p = path.position(path.end_s() * f64::from(i) / 200.0);
                prop_assert!(low - 1e-6 <= p && p <= high + 1e-6);
            }
        }
    }
}
