//! Seats of connections: what each is doing, which one makes room, which has waited too long.
//! Uses: tokio's clock and wake-ups. Never: sockets, requests, a wait.

use std::sync::{Arc, Weak};
use std::time::Duration;

use parking_lot::{Mutex, MutexGuard};
use tokio::sync::Notify;
use tokio::sync::futures::Notified;
use tokio::time::Instant;

/// Connections at once. A page holds about six, a script one; the rest is room for streams.
const CONNECTIONS: usize = 512;
/// Connections beyond these, while all of them are busy, that reach only the stop and /health.
const RESERVED: usize = 32;
/// Connections at once with those that were told to go and have not gone yet.
const WITH_LEAVING: usize = 2 * CONNECTIONS;
/// Longest time for the head of a request: from the connection's begin, or from its first byte.
const HEAD: Duration = Duration::from_secs(5);
/// Longest time from the end of an answer to the next request.
const IDLE: Duration = Duration::from_secs(60);

/// The seats that are taken.
#[derive(Default)]
pub struct Seats {
    taken: Vec<Weak<Seat>>,
    freed: Arc<Notify>,
}

impl Seats {
    /// Whether one more can be taken in, if need be in the place of one that waits.
    pub fn have_room(&mut self) -> bool {
        self.taken.retain(|seat| seat.strong_count() > 0);
        let most = CONNECTIONS + RESERVED;
        let one_waits = || self.all().any(|seat| seat.waits_since().is_some());
        self.taken.len() < most
            || self.taken.len() < WITH_LEAVING && (self.staying().count() < most || one_waits())
    }

    /// Wakes when a request or a connection has ended.
    pub fn one_is_freed(&self) -> Notified<'_> {
        self.freed.notified()
    }

    /// A seat for a connection that has come: a reserved one if all others are busy.
    pub fn take(&mut self) -> Arc<Seat> {
        let staying = |reserved| self.staying().filter(|s| s.reserved == reserved).count();
        let reserved = staying(false) >= CONNECTIONS && !self.dismiss_one(|s| !s.reserved);
        if reserved && staying(true) >= RESERVED {
            self.dismiss_one(|s| s.reserved);
        }
        let seat = Arc::new(Seat {
            reserved,
            doing: Mutex::new(Doing::waits(HEAD)),
            dismissed: Notify::new(),
            freed: self.freed.clone(),
        });
        self.taken.push(Arc::downgrade(&seat));
        seat
    }

    /// Tells the connection to go that has waited longest without a request. False if none waits.
    pub fn make_room(&self) -> bool {
        self.dismiss_one(|_| true)
    }

    /// Tells those to go that have waited too long.
    pub fn sweep(&self, now: Instant) {
        for seat in self.all() {
            if matches!(*seat.doing(), Doing::Waits { until, .. } if until < now) {
                seat.dismiss();
            }
        }
    }

    fn all(&self) -> impl Iterator<Item = Arc<Seat>> {
        self.taken.iter().filter_map(Weak::upgrade)
    }

    /// Those that were not told to go.
    fn staying(&self) -> impl Iterator<Item = Arc<Seat>> {
        self.all().filter(|seat| !seat.is_leaving())
    }

    fn dismiss_one(&self, of: impl Fn(&Seat) -> bool) -> bool {
        let waiting = self.all().filter(|seat| of(seat));
        let waiting = waiting.filter_map(|seat| Some((seat.waits_since()?, seat)));
        let longest = waiting.min_by_key(|(since, _)| *since);
        longest.is_some_and(|(_, seat)| seat.dismiss())
    }
}

/// What a connection is doing.
enum Doing {
    /// No request is under way: since when, and how long it may be so.
    Waits { since: Instant, until: Instant },
    /// A request is under way.
    Asks,
    /// It has become a WebSocket, and stays until it ends by itself.
    Stays,
    /// It was told to go.
    Leaves,
}

impl Doing {
    fn waits(at_most: Duration) -> Self {
        let since = Instant::now();
        Self::Waits { since, until: since + at_most }
    }
}

/// The seat of one connection. It is free when the connection and all that is sent over it are gone.
pub struct Seat {
    reserved: bool,
    doing: Mutex<Doing>,
    dismissed: Notify,
    freed: Arc<Notify>,
}

impl Seat {
    /// Whether only the stop and /health are reached from here.
    pub fn reserved(&self) -> bool {
        self.reserved
    }

    /// Whether it was told to go, and no request has come since.
    pub fn is_leaving(&self) -> bool {
        matches!(*self.doing(), Doing::Leaves)
    }

    /// Waits until it is told to go.
    pub fn dismissed(&self) -> Notified<'_> {
        self.dismissed.notified()
    }

    /// It has become a WebSocket.
    pub fn keep(&self) {
        *self.doing() = Doing::Stays;
    }

    /// Bytes have come: a head that begins must end soon.
    pub fn bytes_came(&self) {
        if let Doing::Waits { until, .. } = &mut *self.doing() {
            *until = (*until).min(Instant::now() + HEAD);
        }
    }

    /// Bytes go: the rest of an answer, whose client is there.
    pub fn bytes_go(&self) {
        let mut doing = self.doing();
        if matches!(*doing, Doing::Waits { .. }) {
            *doing = Doing::waits(IDLE);
        }
    }

    fn waits_since(&self) -> Option<Instant> {
        match *self.doing() {
            Doing::Waits { since, .. } => Some(since),
            Doing::Asks | Doing::Stays | Doing::Leaves => None,
        }
    }

    /// Tells it to go, if it waits.
    fn dismiss(&self) -> bool {
        let mut doing = self.doing();
        let waits = matches!(*doing, Doing::Waits { .. });
        if waits {
            *doing = Doing::Leaves;
            self.dismissed.notify_one();
        }
        waits
    }

    fn doing(&self) -> MutexGuard<'_, Doing> {
        self.doing.lock()
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.freed.notify_one();
    }
}

/// A request under way; dropped when its answer has been sent or given up.
pub struct Asking(Arc<Seat>);

impl Asking {
    /// A request has come.
    pub fn begin(seat: Arc<Seat>) -> Self {
        *seat.doing() = Doing::Asks;
        Self(seat)
    }
}

impl Drop for Asking {
    fn drop(&mut self) {
        let mut doing = self.0.doing();
        if matches!(*doing, Doing::Asks) {
            *doing = Doing::waits(IDLE);
            self.0.freed.notify_one();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reserved(seats: &[Arc<Seat>]) -> usize {
        seats.iter().filter(|seat| seat.reserved()).count()
    }

    #[test]
    fn the_one_that_waited_longest_makes_room() {
        let mut seats = Seats::default();
        let mut sitting: Vec<_> = (0..CONNECTIONS).map(|_| seats.take()).collect();
        let busy = Asking::begin(sitting[0].clone());
        sitting.push(seats.take());
        assert!(seats.have_room() && reserved(&sitting) == 0);
        let leaving: Vec<bool> = sitting.iter().map(|seat| seat.is_leaving()).collect();
        assert_eq!(leaving.iter().filter(|leaves| **leaves).count(), 1);
        assert!(!leaving[0] && !leaving[CONNECTIONS], "neither a busy one nor the newest");
        drop(busy);
    }

    #[test]
    fn busy_ones_leave_the_reserved_seats_to_the_stop() {
        let mut seats = Seats::default();
        let sitting: Vec<_> = (0..CONNECTIONS).map(|_| seats.take()).collect();
        let busy: Vec<_> = sitting.iter().cloned().map(Asking::begin).collect();
        // Those that come and wait push each other out, and none gets an ordinary seat.
        let late: Vec<_> = (0..3 * RESERVED).map(|_| seats.take()).collect();
        assert_eq!(reserved(&late), late.len());
        assert_eq!(late.iter().filter(|seat| !seat.is_leaving()).count(), RESERVED);
        assert!(seats.have_room());
        let asking: Vec<_> = late[2 * RESERVED..].iter().cloned().map(Asking::begin).collect();
        drop(late);
        assert!(!seats.have_room(), "nobody waits");
        drop(asking);
        drop(busy);
        assert!(seats.have_room() && !seats.take().reserved());
    }

    #[test]
    fn heads_and_idle_connections_have_their_time_and_streams_all_of_it() {
        let mut seats = Seats::default();
        let [silent, slow, idle, stream, socket] = std::array::from_fn(|_| seats.take());
        let _streaming = Asking::begin(stream.clone());
        Asking::begin(socket.clone()).0.keep();
        drop(Asking::begin(idle.clone()));
        drop(Asking::begin(slow.clone()));
        slow.bytes_came();
        let start = Instant::now();
        let gone_after = |time: Duration| {
            seats.sweep(start + time);
            [&silent, &slow, &idle, &stream, &socket].map(|seat| seat.is_leaving())
        };
        assert_eq!(gone_after(HEAD / 2), [false; 5]);
        let late = Duration::from_millis(1);
        assert_eq!(gone_after(HEAD + late), [true, true, false, false, false]);
        assert_eq!(gone_after(IDLE + late), [true, true, true, false, false]);
        assert_eq!(gone_after(10 * IDLE), [true, true, true, false, false]);
    }
}
