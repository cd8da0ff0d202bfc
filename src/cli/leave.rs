//! What Ctrl-C at a followed run or training means: a question at a terminal, a stop without one.
//! PURE. Uses: no other module. Never: the terminal, a request.

/// What a person answers to the question.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Choice {
    /// Leave the run to the service.
    Detach,
    /// Pause after the trial.
    Pause,
    /// Resume a paused run.
    Resume,
    /// End after the trial; the run can be resumed later.
    Stop,
    /// Continue to follow.
    Continue,
}

impl Choice {
    /// The choice of an entered line: the first letter of its word, or nothing to continue.
    pub fn of(line: &str) -> Option<Self> {
        Some(match line.trim().to_ascii_lowercase().as_str() {
            "d" | "detach" => Self::Detach,
            "p" | "pause" => Self::Pause,
            "r" | "resume" => Self::Resume,
            "s" | "stop" => Self::Stop,
            "" | "c" | "continue" => Self::Continue,
            _ => return None,
        })
    }
}

/// The question, on a run that is driven or paused.
pub fn question(is_paused: bool) -> &'static str {
    if is_paused {
        "d  detach: the run stays paused\nr  resume\ns  stop: the run can be resumed later\nc  continue\n\
         Ctrl-C again raises the tips now and aborts"
    } else {
        "d  detach: the run continues\np  pause after this trial\ns  stop after this trial: the run can be resumed \
         later\nc  continue\nCtrl-C again raises the tips now and aborts"
    }
}

/// The question on a training.
pub const QUESTION_ON_TRAINING: &str = "d  detach: the training continues\n\
     s  stop: the same command resumes it\nc  continue\nCtrl-C again stops";

/// What an interrupt leads to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Interrupt {
    /// Ask what to do.
    Ask,
    /// Stop after the trial.
    Stop,
    /// Raise the tips now and end.
    Abort,
    /// Leave the run as it is.
    Leave,
}

impl Interrupt {
    /// The meaning of the n-th interrupt since the last answer, from 1.
    pub fn of(count: u32, at_terminal: bool) -> Self {
        match count {
            0 | 1 if at_terminal => Self::Ask,
            0 | 1 => Self::Stop,
            2 => Self::Abort,
            _ => Self::Leave,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_letter_of_the_question_is_an_answer() {
        for is_paused in [false, true] {
            let letters: Vec<&str> =
                question(is_paused).split_whitespace().filter(|w| w.len() == 1).collect();
            assert_eq!(letters.len(), 4);
            assert!(letters.iter().all(|letter| Choice::of(letter).is_some()), "{letters:?}");
        }
        assert_eq!(Choice::of(" Stop\n"), Some(Choice::Stop));
        assert_eq!(Choice::of("\n"), Some(Choice::Continue));
        assert_eq!(Choice::of("quit"), None);
    }

    #[test]
    fn a_second_interrupt_aborts_with_and_without_a_terminal() {
        for at_terminal in [false, true] {
            assert_eq!(Interrupt::of(2, at_terminal), Interrupt::Abort);
            assert_eq!(Interrupt::of(3, at_terminal), Interrupt::Leave);
        }
        assert_eq!(Interrupt::of(1, true), Interrupt::Ask);
        assert_eq!(Interrupt::of(1, false), Interrupt::Stop);
    }
}
