//! Seats: one entry per connection, with its state, which decides which connection is closed next.
//! Uses: tokio's clock and wake-ups. Never: sockets, requests, a wait.

use std::sync::{Arc, Weak};

use parking_lot::Mutex;
use tokio::sync::Notify;
use tokio::sync::futures::Notified;
use tokio::time::Instant;

use super::limits::{CONNECTIONS, HEAD_WITHIN, IDLE_WITHIN, RESERVED, YOUNG};

/// Largest number of connections including those that are being closed.
const WITH_CLOSING: usize = 2 * CONNECTIONS;

/// All taken seats.
#[derive(Default)]
pub struct Seats {
    taken: Vec<Weak<Seat>>,
    freed: Arc<Notify>,
}

impl Seats {
    /// True if another connection can be accepted, possibly after closing an idle one.
    pub fn have_room(&mut self, now: Instant) -> bool {
        self.taken.retain(|seat| seat.strong_count() > 0);
        let most = CONNECTIONS + RESERVED;
        let one_is_idle = || self.all().any(|seat| seat.idle_since(now).is_some());
        self.taken.len() < most
            || self.taken.len() < WITH_CLOSING && (self.open().count() < most || one_is_idle())
    }

    /// Completes when a request or a connection has ended.
    pub fn one_is_freed(&self) -> Notified<'_> {
        self.freed.notified()
    }

    /// Takes a seat for a new connection: a reserved one if all ordinary ones are busy, or became
    /// idle less than `YOUNG` ago.
    pub fn take(&mut self, now: Instant) -> Arc<Seat> {
        let open = |reserved| self.open().filter(|s| s.reserved == reserved).count();
        let reserved = open(false) >= CONNECTIONS && !self.close_idlest(now, |s| !s.reserved);
        if reserved && open(true) >= RESERVED {
            self.close_idlest(now, |s| s.reserved);
        }
        let seat = Arc::new(Seat {
            reserved,
            state: Mutex::new(State::new()),
            closed: Notify::new(),
            freed: self.freed.clone(),
        });
        self.taken.push(Arc::downgrade(&seat));
        seat
    }

    /// Closes the connection that has been idle for longest; false if none is idle.
    pub fn make_room(&self, now: Instant) -> bool {
        self.close_idlest(now, |_| true)
    }

    /// Closes the connections whose idle time has expired.
    pub fn sweep(&self, now: Instant) {
        for seat in self.all() {
            if matches!(*seat.state.lock(), State::Idle { until, .. } if until < now) {
                seat.close();
            }
        }
    }

    fn all(&self) -> impl Iterator<Item = Arc<Seat>> {
        self.taken.iter().filter_map(Weak::upgrade)
    }

    /// Seats of connections that are not being closed.
    fn open(&self) -> impl Iterator<Item = Arc<Seat>> {
        self.all().filter(|seat| !seat.is_closing())
    }

    /// Closes the connection that has been idle for longest, of those for which `of` is true.
    fn close_idlest(&self, now: Instant, of: impl Fn(&Seat) -> bool) -> bool {
        let idle = self.all().filter(|seat| of(seat));
        let idle = idle.filter_map(|seat| Some((seat.idle_since(now)?, seat)));
        let longest = idle.min_by_key(|(since, _)| *since);
        longest.is_some_and(|(_, seat)| seat.close())
    }
}

/// State of a connection.
enum State {
    /// No request is in progress since `since`; the connection is closed at `until`. `new`: there
    /// was none yet, and the only bytes that are sent are those of a TLS handshake.
    Idle { since: Instant, until: Instant, new: bool },
    /// A request is in progress.
    Busy,
    /// The connection has become a WebSocket; it is not closed from here.
    Upgraded,
    /// The connection is being closed, after the response to a request that still arrived if
    /// `answering`. It counts as closed, so it cannot become an ordinary busy one again.
    Closing { answering: bool },
}

impl State {
    /// State of a new connection.
    fn new() -> Self {
        let since = Instant::now();
        Self::Idle { since, until: since + HEAD_WITHIN, new: true }
    }

    /// State after a request.
    fn idle() -> Self {
        let since = Instant::now();
        Self::Idle { since, until: since + IDLE_WITHIN, new: false }
    }
}

/// The seat of one connection; free after the connection and the bodies sent over it are dropped.
pub struct Seat {
    reserved: bool,
    state: Mutex<State>,
    closed: Notify,
    freed: Arc<Notify>,
}

impl Seat {
    /// True if the connection may only be used for the e-stop and /health: its seat is reserved,
    /// or it is being closed in favour of another one.
    pub fn only_for_stops(&self) -> bool {
        self.reserved || self.is_closing()
    }

    /// True if the connection is being closed and no request has arrived since.
    pub fn ends_now(&self) -> bool {
        matches!(*self.state.lock(), State::Closing { answering: false })
    }

    /// Completes when the connection must be closed, see `ends_now`.
    pub fn closed(&self) -> Notified<'_> {
        self.closed.notified()
    }

    /// Records that the connection has become a WebSocket.
    pub fn upgrade(&self) {
        *self.state.lock() = State::Upgraded;
    }

    /// Records received bytes: the head of a request that begins must be complete within `HEAD_WITHIN`.
    pub fn bytes_received(&self) {
        if let State::Idle { until, .. } = &mut *self.state.lock() {
            *until = (*until).min(Instant::now() + HEAD_WITHIN);
        }
    }

    /// Records sent bytes: while the rest of a response is sent, the idle time starts again.
    pub fn bytes_sent(&self) {
        let mut state = self.state.lock();
        if matches!(*state, State::Idle { new: false, .. }) {
            *state = State::idle();
        }
    }

    /// Start of an idle time of at least `YOUNG`: the connection may be closed in favour of another
    /// one. Until then its first or next request, which may be a stop, has time to arrive.
    fn idle_since(&self, now: Instant) -> Option<Instant> {
        match *self.state.lock() {
            State::Idle { since, .. } => (since + YOUNG <= now).then_some(since),
            State::Busy | State::Upgraded | State::Closing { .. } => None,
        }
    }

    fn is_closing(&self) -> bool {
        matches!(*self.state.lock(), State::Closing { .. })
    }

    /// Closes the connection if it is idle; returns whether it was.
    fn close(&self) -> bool {
        let mut state = self.state.lock();
        let idle = matches!(*state, State::Idle { .. });
        if idle {
            *state = State::Closing { answering: false };
            self.closed.notify_one();
        }
        idle
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.freed.notify_one();
    }
}

/// A request in progress; dropped when its response has been sent or dropped.
pub struct InFlight(Arc<Seat>);

impl InFlight {
    /// Records that a request has arrived.
    pub fn begin(seat: Arc<Seat>) -> Self {
        {
            let mut state = seat.state.lock();
            *state = match *state {
                State::Closing { .. } => State::Closing { answering: true },
                State::Idle { .. } | State::Busy | State::Upgraded => State::Busy,
            };
        }
        Self(seat)
    }
}

impl Drop for InFlight {
    fn drop(&mut self) {
        let mut state = self.0.state.lock();
        if matches!(*state, State::Busy) {
            *state = State::idle();
            self.0.freed.notify_one();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn reserved(seats: &[Arc<Seat>]) -> usize {
        seats.iter().filter(|seat| seat.reserved).count()
    }

    /// A time at which no connection is young.
    fn later() -> Instant {
        Instant::now() + YOUNG
    }

    #[test]
    fn no_connection_is_closed_for_another_one_before_its_request_can_have_arrived() {
        let (mut seats, start) = (Seats::default(), Instant::now());
        let mut taken: Vec<_> = (0..CONNECTIONS + RESERVED).map(|_| seats.take(start)).collect();
        assert!(taken.iter().all(|seat| !seat.is_closing()));
        assert_eq!(reserved(&taken), RESERVED);
        assert!(!seats.have_room(start) && !seats.make_room(start));
        assert!(seats.have_room(later()));
        taken.push(seats.take(later()));
        assert_eq!(reserved(&taken), RESERVED, "the newest one is ordinary");
        assert!(taken[0].ends_now() && taken[1..].iter().all(|seat| !seat.is_closing()));
    }

    #[test]
    fn the_connection_that_is_idle_for_longest_is_closed() {
        let mut seats = Seats::default();
        let mut taken: Vec<_> = (0..CONNECTIONS).map(|_| seats.take(later())).collect();
        let busy = InFlight::begin(taken[0].clone());
        taken.push(seats.take(later()));
        assert!(seats.have_room(later()) && reserved(&taken) == 0);
        let closing: Vec<bool> = taken.iter().map(|seat| seat.is_closing()).collect();
        assert_eq!(closing.iter().filter(|closes| **closes).count(), 1);
        assert!(!closing[0] && !closing[CONNECTIONS], "neither a busy one nor the newest");
        drop(busy);
    }

    #[test]
    fn reserved_seats_stay_available_while_all_connections_are_busy() {
        let (mut seats, start) = (Seats::default(), Instant::now());
        let ordinary: Vec<_> = (0..CONNECTIONS).map(|_| seats.take(later())).collect();
        let busy: Vec<_> = ordinary.iter().cloned().map(InFlight::begin).collect();
        // Idle newcomers replace each other, and none gets an ordinary seat.
        let late: Vec<_> = (0..3 * RESERVED).map(|_| seats.take(later())).collect();
        assert_eq!(reserved(&late), late.len());
        assert_eq!(late.iter().filter(|seat| !seat.is_closing()).count(), RESERVED);
        assert!(!seats.have_room(start), "the newest may still send their requests");
        assert!(seats.have_room(later()));
        let stops: Vec<_> = late[2 * RESERVED..].iter().cloned().map(InFlight::begin).collect();
        drop(late);
        assert!(!seats.have_room(later()), "no connection is idle");
        drop(stops);
        drop(busy);
        assert!(seats.have_room(later()) && !seats.take(later()).reserved);
    }

    #[test]
    fn a_request_on_a_connection_that_is_being_closed_takes_no_ordinary_seat() {
        let mut seats = Seats::default();
        let old: Vec<_> = (0..CONNECTIONS).map(|_| seats.take(later())).collect();
        let new: Vec<_> = (0..CONNECTIONS).map(|_| seats.take(later())).collect();
        assert!(old.iter().all(|seat| seat.ends_now() && seat.only_for_stops()));
        // Their requests had arrived already: they are answered, as on a reserved seat.
        let late: Vec<_> = old.iter().cloned().map(InFlight::begin).collect();
        assert!(old.iter().all(|seat| !seat.ends_now() && seat.only_for_stops()));
        let busy: Vec<_> = new.iter().cloned().map(InFlight::begin).collect();
        assert!(new.iter().all(|seat| !seat.only_for_stops()));
        drop((late, old));
        assert!(seats.have_room(later()) && seats.take(later()).reserved);
        drop(busy);
    }

    #[test]
    fn heads_and_idle_connections_have_a_time_limit_and_streams_have_none() {
        let mut seats = Seats::default();
        let [silent, shaking, slow, idle, stream, socket] =
            std::array::from_fn(|_| seats.take(later()));
        let _streaming = InFlight::begin(stream.clone());
        InFlight::begin(socket.clone()).0.upgrade();
        drop(InFlight::begin(idle.clone()));
        drop(InFlight::begin(slow.clone()));
        slow.bytes_received();
        // A TLS handshake is no request: what it sends gains no time.
        shaking.bytes_received();
        shaking.bytes_sent();
        let start = Instant::now();
        let closed_after = |time: Duration| {
            seats.sweep(start + time);
            [&silent, &shaking, &slow, &idle, &stream, &socket].map(|seat| seat.is_closing())
        };
        assert_eq!(closed_after(HEAD_WITHIN / 2), [false; 6]);
        let late = Duration::from_millis(1);
        assert_eq!(closed_after(HEAD_WITHIN + late), [true, true, true, false, false, false]);
        assert_eq!(closed_after(IDLE_WITHIN + late), [true, true, true, true, false, false]);
        assert_eq!(closed_after(10 * IDLE_WITHIN), [true, true, true, true, false, false]);
    }
}
