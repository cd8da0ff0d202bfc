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
    /// Leave the run as it is, and continue to follow it.
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

/// The question on a run that is driven.
pub const QUESTION_ON_RUN: &str = "one letter, then Enter:\n\
     d  detach: the run continues\np  pause after this trial\n\
     s  stop after this trial: the run can be resumed later\nc  continue\n\
     Ctrl-C again raises the tips now and aborts";

/// The question on a run that is paused.
pub const QUESTION_ON_PAUSED_RUN: &str = "one letter, then Enter:\n\
     d  detach: the run stays paused\nr  resume (answer within 10 s)\n\
     s  stop: the run can be resumed later\nc  continue\n\
     Ctrl-C again raises the tips now and aborts";

/// The question on a run that waits for its turn.
pub const QUESTION_ON_WAITING_RUN: &str = "one letter, then Enter:\n\
     d  detach: the run begins when its turn comes\n\
     s  take its start back: if queued, it leaves the queue\nc  continue\nCtrl-C again takes its start back";

/// The question on a training.
pub const QUESTION_ON_TRAINING: &str = "one letter, then Enter:\n\
     d  detach: the training continues\n\
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
    /// The meaning of the n-th interrupt since the last answer, from 1. `can_ask`: whether a person can be asked, at a
    /// terminal.
    pub fn of(count: u32, can_ask: bool) -> Self {
        match (count, can_ask) {
            (0 | 1, true) => Self::Ask,
            (0 | 1, false) => Self::Stop,
            (2, _) => Self::Abort,
            _ => Self::Leave,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_letter_of_the_question_is_an_answer() {
        for (question, count) in [
            (QUESTION_ON_RUN, 4),
            (QUESTION_ON_PAUSED_RUN, 4),
            (QUESTION_ON_WAITING_RUN, 3),
            (QUESTION_ON_TRAINING, 3),
        ] {
            assert!(question.starts_with("one letter, then Enter:\n"), "{question}");
            let letters: Vec<&str> = question.split_whitespace().filter(|w| w.len() == 1).collect();
            assert_eq!(letters.len(), count);
            assert!(letters.iter().all(|letter| Choice::of(letter).is_some()), "{letters:?}");
        }
        assert_eq!(Choice::of(" Stop\n"), Some(Choice::Stop));
        assert_eq!(Choice::of("\n"), Some(Choice::Continue));
        assert_eq!(Choice::of("quit"), None);
    }

    #[test]
    fn a_second_interrupt_aborts_with_and_without_a_terminal() {
        for can_ask in [true, false] {
            assert_eq!(Interrupt::of(2, can_ask), Interrupt::Abort);
            assert_eq!(Interrupt::of(3, can_ask), Interrupt::Leave);
        }
        assert_eq!(Interrupt::of(1, true), Interrupt::Ask);
        assert_eq!(Interrupt::of(1, false), Interrupt::Stop);
    }
}
