//! Priority of the present thread among all programs of the machine.
//! Uses: the system's nice values, which Linux keeps for each thread. Never: an error: a thread whose priority
//! cannot be changed works as well, only later when the processors are busy.

/// Nice value of a thread that moves, measures, stores or stops: it gets about ten times as much processor time
/// as a thread at 0, and gets it at once.
const URGENT: i32 = -10;
/// Nice value of work that takes seconds.
const BACKGROUND: i32 = 10;

/// Raises the priority, so that a busy machine delays neither motion nor stop. The threads that this one starts
/// inherit it.
///
/// The system refuses unless the user has the right (`LimitNICE=` of systemd, `nice` in `limits.conf`, root).
pub fn raise() {
    set(URGENT);
}

/// Lowers the priority for the rest of the thread's life.
pub fn lower() {
    set(BACKGROUND);
}

fn set(nice: i32) {
    if let Err(error) = rustix::process::setpriority_process(None, nice) {
        tracing::debug!(%error, nice, "the thread keeps its priority");
    }
}

#[cfg(test)]
mod tests {
    use rustix::process::getpriority_process;

    use super::*;

    #[test]
    fn a_priority_is_that_of_its_thread_and_of_those_that_it_starts() {
        let now = || getpriority_process(None).unwrap();
        let before = now();
        let lowered = std::thread::spawn(move || {
            lower();
            (now(), std::thread::spawn(now).join().unwrap())
        });
        assert_eq!(lowered.join().unwrap(), (BACKGROUND, BACKGROUND));
        let raised = std::thread::spawn(move || {
            raise();
            now()
        });
        let raised = raised.join().unwrap();
        assert!(raised == URGENT || raised == before, "{raised}");
        assert_eq!(now(), before);
    }
}
