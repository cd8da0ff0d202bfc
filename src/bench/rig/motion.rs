//! Detects whether an axis moves, from the state of its drive, its last command and its positions.
//! PURE (times are passed in). Uses: nothing. Never: registers, waits.
//!
//! The drive alone is not always sufficient. Just after a command it may still report the earlier
//! standstill; and a drive that only reports "in position" reports the same for a moving axis and
//! for one that stopped short. A command therefore counts as motion for a moment, and an axis whose
//! drive is unsure moves as long as its position changes.
//!
//! A reading was taken at some time between the request and its reply. Between two readings there
//! was at least the time from the reply of the first to the request of the second, and only this
//! time counts towards standstill: a late reply is no evidence.

/// Longest time until a drive shows the effect of a command, process s.
const LATENCY_S: f64 = 0.02;
/// Time without a change of position after which an axis with an unsure drive is at rest, process
/// s. At 0.01 mm per count this detects speeds down to 0.1 mm/s.
const STILL_S: f64 = 0.1;
/// The same during homing, which pauses between its phases, process s.
const STILL_HOMING_S: f64 = 1.0;
/// Multiple of the travelling speed above which a change of position is implausible and read again.
const IMPLAUSIBLE_SPEEDUP: f64 = 3.0;
/// Change of position that is always plausible, units.
const PLAUSIBLE_STEP: f64 = 1.0;

/// State of motion as reported by a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Going {
    /// The axis moves.
    Moving,
    /// The axis is at rest.
    Standing,
    /// The axis is not at its target: it moves, or it stopped short.
    Unsure,
}

/// Last command to an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// Move to a position, in the axis's unit.
    Move(f64),
    /// Home: find the zero of the axis.
    Home,
    /// Stop before the target is reached.
    Stop,
}

/// One reading of a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Time of the request, process s.
    pub asked_s: f64,
    /// Time of the reply, process s.
    pub arrived_s: f64,
    /// State of motion as reported by the drive.
    pub going: Going,
    /// Measured position, units.
    pub position: f64,
    /// Whether homing is complete.
    pub homed: bool,
}

/// Properties of an axis by which its motion is judged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisMotion {
    /// Arrival tolerance, units.
    pub tolerance: f64,
    /// Travelling speed, units/s.
    pub speed: f64,
}

/// Detects the motion of one axis.
#[derive(Debug, Clone)]
pub struct MotionWatch {
    axis: AxisMotion,
    command: Option<(Command, f64)>,
    last: Option<Last>,
}

#[derive(Debug, Clone, Copy)]
struct Last {
    seen: Seen,
    /// Arrival of the first reading at this position since the last command.
    there_since_s: f64,
    moving: bool,
}

impl MotionWatch {
    /// Creates the detector of an axis.
    pub fn new(axis: AxisMotion) -> Self {
        Self { axis, command: None, last: None }
    }

    /// Records a command that was sent at process time `t_s`.
    pub fn commanded(&mut self, command: Command, t_s: f64) {
        self.command = Some((command, t_s));
    }

    /// Whether the axis was at rest at the last reading and no command has moved it since.
    pub fn stood(&self) -> bool {
        let told_s = match self.command {
            Some((Command::Move(_) | Command::Home, t_s)) => t_s,
            Some((Command::Stop, _)) | None => f64::NEG_INFINITY,
        };
        self.last.is_some_and(|l| !l.moving && l.seen.asked_s >= told_s)
    }

    /// Whether a position cannot be reached from the last one: a flipped bit, not a motion.
    pub fn implausible(&self, seen: Seen) -> bool {
        let homing = matches!(self.command, Some((Command::Home, _)));
        !homing
            && self.last.is_some_and(|l| {
                let longest_s = seen.arrived_s - l.seen.asked_s;
                let reach = IMPLAUSIBLE_SPEEDUP * self.axis.speed * longest_s + PLAUSIBLE_STEP;
                (seen.position - l.seen.position).abs() > reach
            })
    }

    /// Adds a reading. Returns whether the axis moves.
    pub fn observe(&mut self, seen: Seen) -> bool {
        let told_s = self.command.map_or(f64::NEG_INFINITY, |(_, t_s)| t_s);
        let there_since_s = match self.last {
            Some(l) if l.seen.position == seen.position && l.seen.asked_s >= told_s => {
                l.there_since_s
            }
            Some(_) | None => seen.arrived_s,
        };
        let moving = self.judge(seen, there_since_s);
        self.last = Some(Last { seen, there_since_s, moving });
        moving
    }

    fn judge(&self, seen: Seen, there_since_s: f64) -> bool {
        let command = self.command.map(|(command, _)| command);
        let fresh = self.command.is_some_and(|(_, told_s)| seen.asked_s - told_s < LATENCY_S);
        let still_s = match command {
            Some(Command::Home) if !seen.homed => STILL_HOMING_S,
            _ => STILL_S,
        };
        match (seen.going, command) {
            (Going::Moving, _) => true,
            (Going::Unsure, _) => seen.asked_s - there_since_s < still_s,
            (Going::Standing, Some(Command::Move(target))) => {
                fresh && (seen.position - target).abs() > self.axis.tolerance
            }
            (Going::Standing, Some(Command::Home)) => fresh && !seen.homed,
            (Going::Standing, Some(Command::Stop) | None) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXIS: AxisMotion = AxisMotion { tolerance: 0.05, speed: 100.0 };

    /// A reading whose reply arrived within a microsecond.
    fn seen(going: Going, position: f64, t_s: f64) -> Seen {
        Seen { asked_s: t_s, arrived_s: t_s + 1e-6, going, position, homed: true }
    }

    #[test]
    fn a_move_just_told_is_under_way_although_the_drive_still_reports_the_stand_before_it() {
        let mut watch = MotionWatch::new(AXIS);
        watch.commanded(Command::Move(10.0), 1.0);
        assert!(watch.observe(seen(Going::Standing, 0.0, 1.001)));
        assert!(!watch.observe(seen(Going::Standing, 0.0, 1.1)), "a drive that never starts");
    }

    #[test]
    fn an_axis_that_is_there_already_is_not_under_way() {
        let mut watch = MotionWatch::new(AXIS);
        watch.commanded(Command::Move(10.0), 1.0);
        assert!(!watch.observe(seen(Going::Standing, 10.01, 1.001)));
    }

    #[test]
    fn an_unsure_drive_moves_while_its_position_changes() {
        let mut watch = MotionWatch::new(AXIS);
        watch.commanded(Command::Move(10.0), 0.0);
        assert!(watch.observe(seen(Going::Unsure, 1.0, 0.05)));
        watch.commanded(Command::Stop, 0.06);
        assert!(watch.observe(seen(Going::Unsure, 1.4, 0.07)));
        assert!(watch.observe(seen(Going::Unsure, 1.5, 0.08)));
        assert!(watch.observe(seen(Going::Unsure, 1.5, 0.10)));
        assert!(!watch.observe(seen(Going::Unsure, 1.5, 0.19)));
        assert!(watch.stood());
    }

    #[test]
    fn a_late_reply_after_a_command_proves_no_stand() {
        let mut watch = MotionWatch::new(AXIS);
        watch.observe(seen(Going::Unsure, 5.0, 0.5));
        watch.commanded(Command::Move(10.0), 1.0);
        // Taken just after the command, before anything moved, but delayed by a second.
        let late = Seen { arrived_s: 2.0, ..seen(Going::Unsure, 5.0, 1.001) };
        assert!(watch.observe(late));
        assert!(watch.observe(seen(Going::Unsure, 5.0, 2.05)));
        assert!(!watch.observe(seen(Going::Unsure, 5.0, 2.2)), "at rest for 0.2 s");
    }

    #[test]
    fn homing_may_rest_between_its_phases() {
        let mut watch = MotionWatch::new(AXIS);
        watch.commanded(Command::Home, 0.0);
        let unhomed = |going, p, t| Seen { homed: false, ..seen(going, p, t) };
        assert!(watch.observe(unhomed(Going::Unsure, 5.0, 0.5)));
        assert!(watch.observe(unhomed(Going::Unsure, 5.0, 1.4)));
        assert!(!watch.observe(unhomed(Going::Unsure, 5.0, 1.6)));
        assert!(!watch.observe(seen(Going::Standing, 0.0, 1.7)));
    }

    #[test]
    fn a_position_out_of_reach_is_implausible_and_a_quick_move_is_not() {
        let mut watch = MotionWatch::new(AXIS);
        watch.observe(seen(Going::Standing, 50.0, 1.0));
        assert!(watch.implausible(seen(Going::Standing, 50.0 + 655.36, 1.01)));
        assert!(!watch.implausible(seen(Going::Standing, 51.5, 1.01)));
        watch.commanded(Command::Home, 1.01);
        let home = seen(Going::Standing, 0.0, 1.02);
        assert!(!watch.implausible(home), "homing moves the zero");
    }

    #[test]
    fn an_axis_told_to_move_has_not_stood_since() {
        let mut watch = MotionWatch::new(AXIS);
        assert!(!watch.stood(), "never read");
        watch.observe(seen(Going::Standing, 0.0, 1.0));
        assert!(watch.stood());
        watch.commanded(Command::Move(5.0), 1.5);
        assert!(!watch.stood());
    }
}
