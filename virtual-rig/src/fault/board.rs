//! Active faults: they begin when their start is reached, and end when their time or count is used
//! up.
//! PURE. Uses: `fault`. Never: clocks (times are passed in), wires.

use super::{CellFault, Fault, Kind, Start, Target, WireFault};
use crate::config::{ARMS, AxisName};

#[derive(Debug, Clone)]
struct Entry {
    fault: Fault,
    began_s: Option<f64>,
    struck: u32,
}

impl Entry {
    fn active(&self, t_s: f64) -> bool {
        let Some(began) = self.began_s else { return false };
        self.fault.for_s.is_none_or(|f| t_s < began + f)
            && self.fault.count.is_none_or(|c| self.struck < c)
    }
}

/// A fault of a cell in effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ActiveFault {
    /// Index of the arm of the cell, from 0.
    pub arm: usize,
    /// What happens to it.
    pub fault: CellFault,
    /// Process time of its begin, s.
    pub began_s: f64,
}

/// All faults of a rig, with their states.
#[derive(Debug, Clone, Default)]
pub struct Board {
    entries: Vec<Entry>,
}

impl Board {
    /// Creates a board with the faults of a script.
    pub fn new(faults: Vec<Fault>) -> Self {
        let mut board = Self::default();
        faults.into_iter().for_each(|fault| board.add(fault));
        board
    }

    /// Adds a fault while the rig runs.
    pub fn add(&mut self, fault: Fault) {
        self.entries.push(Entry { fault, began_s: None, struck: 0 });
    }

    /// Whether there are no faults.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Removes all faults.
    pub fn clear(&mut self) {
        self.entries.clear();
    }

    /// Starts the faults that are due.
    pub fn update(&mut self, t_s: f64, frame: u32, presses: u64) {
        for entry in self.entries.iter_mut().filter(|e| e.began_s.is_none()) {
            let due = match entry.fault.start {
                Start::Now => true,
                Start::Time(at) => t_s >= at,
                Start::Frame(at) => frame >= at,
                Start::Press(at) => presses >= at,
            };
            entry.began_s = due.then_some(t_s);
        }
    }

    /// Active faults, the process time of their begin, s, and their counters.
    fn active(&mut self, t_s: f64) -> impl Iterator<Item = (&Fault, f64, &mut u32)> {
        self.entries
            .iter_mut()
            .filter(move |e| e.active(t_s))
            .filter_map(|e| Some((&e.fault, e.began_s?, &mut e.struck)))
    }

    /// Fault of the wire, if any, that affects a request to a device on a line; counts it.
    pub fn strike_request(
        &mut self,
        device: Option<&Target>,
        line: &str,
        t_s: f64,
    ) -> Option<WireFault> {
        for (fault, _, struck) in self.active(t_s) {
            let meant = match &fault.target {
                Target::Line(name) => name == line,
                target => Some(target) == device,
            };
            if let Kind::Wire(wire) = fault.kind
                && meant
            {
                *struck += 1;
                return Some(wire);
            }
        }
        None
    }

    /// Whether a wire is disconnected at present, so that connections are refused.
    pub fn disconnected(&mut self, line: &str, t_s: f64) -> bool {
        self.active(t_s).any(|(fault, _, _)| {
            matches!(fault.kind, Kind::Wire(WireFault::Disconnect { .. }))
                && fault.for_s.is_some()
                && fault.target == Target::Line(line.to_owned())
        })
    }

    /// Process time since which the reads of a device are stale, s.
    pub fn stale_since(&mut self, device: &Target, t_s: f64) -> Option<f64> {
        self.active(t_s)
            .find(|(f, _, _)| f.kind == Kind::StaleRegisters && f.target == *device)
            .map(|(_, began, _)| began)
    }

    /// Whether an axis is stuck, and the time until its drive detects it, s.
    pub fn stuck(&mut self, axis: AxisName, t_s: f64) -> Option<Option<f64>> {
        let target = Target::Axis(axis);
        self.active(t_s).find_map(|(f, _, _)| match f.kind {
            Kind::StuckAxis { alarm_after_s } if f.target == target => Some(alarm_after_s),
            _ => None,
        })
    }

    /// Next alarm, power loss or motor off of an axis that is due and not yet applied.
    pub fn sudden(&mut self, axis: AxisName, t_s: f64) -> Option<Kind> {
        let target = Target::Axis(axis);
        let (fault, _, struck) = self.active(t_s).find(|(f, _, struck)| {
            f.target == target
                && **struck == 0
                && matches!(f.kind, Kind::Alarm { .. } | Kind::PowerLoss | Kind::MotorOff)
        })?;
        *struck += 1;
        Some(fault.kind)
    }

    /// Active faults of the cells.
    pub fn cells(&mut self, t_s: f64) -> Vec<ActiveFault> {
        self.active(t_s)
            .filter_map(|(f, began_s, _)| match f.kind {
                Kind::Cell { arm, fault } => Some(ActiveFault { arm, fault, began_s }),
                _ => None,
            })
            .collect()
    }

    /// Arms whose tip is lost.
    pub fn missing_tips(&mut self, t_s: f64) -> [bool; ARMS] {
        let mut missing = [false; ARMS];
        for (fault, _, _) in self.active(t_s) {
            if let Kind::Cell { arm, fault: CellFault::MissingTip } = fault.kind {
                missing[arm] = true;
            }
        }
        missing
    }

    /// Active faults of the stream.
    pub fn stream(&mut self, t_s: f64) -> Vec<Kind> {
        self.active(t_s)
            .filter(|(f, _, _)| f.target == Target::Ert)
            .map(|(f, _, struck)| {
                *struck = struck.saturating_add(1);
                f.kind
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(kind: Kind, target: Target, start: Start) -> Fault {
        Fault { kind, target, start, for_s: None, count: None }
    }

    #[test]
    fn a_fault_begins_lasts_and_ends() {
        let kind = Kind::Wire(WireFault::NoReply { executed: false });
        let z = Target::Axis(AxisName::Z);
        let timed = Fault { for_s: Some(1.0), ..fault(kind, z.clone(), Start::Time(5.0)) };
        let mut board = Board::new(vec![timed]);
        let mut at = |t: f64| {
            board.update(t, 0, 0);
            board.strike_request(Some(&z), "stage", t).is_some()
        };
        assert_eq!([4.9, 5.0, 5.9, 6.1].map(&mut at), [false, true, true, false]);
    }

    #[test]
    fn a_counted_fault_strikes_so_often() {
        let target = Target::Line("stage".into());
        let kind = Kind::Wire(WireFault::Exception(6));
        let counted = Fault { count: Some(2), ..fault(kind, target, Start::Now) };
        let mut board = Board::new(vec![counted]);
        board.update(0.0, 0, 0);
        let x = Target::Axis(AxisName::X);
        let mut strike = || board.strike_request(Some(&x), "stage", 0.0);
        assert_eq!(strike(), Some(WireFault::Exception(6)));
        assert!(strike().is_some());
        assert_eq!(strike(), None);
    }

    #[test]
    fn another_device_is_spared() {
        let late = WireFault::Late { delay_ms: 5 };
        let kind = Kind::Wire(late);
        let mut board = Board::new(vec![fault(kind, Target::Cells, Start::Press(2))]);
        board.update(1.0, 100, 1);
        assert_eq!(board.strike_request(Some(&Target::Cells), "cells", 1.0), None);
        board.update(2.0, 100, 2);
        let z = Target::Axis(AxisName::Z);
        assert_eq!(board.strike_request(Some(&z), "stage", 2.0), None);
        assert_eq!(board.strike_request(Some(&Target::Cells), "cells", 2.0), Some(late));
    }
}
