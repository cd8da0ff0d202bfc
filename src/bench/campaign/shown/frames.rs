//! The frames of the voltage stream for live views: each in its order, and the newest one.
//! Uses: tokio's channels, `rig::traits`. Never: a wait for a follower; one that is too slow misses frames.

use std::sync::Arc;

use tokio::sync::{broadcast, watch};

use crate::rig::traits::Frame;

/// Frames that a follower may be behind: two seconds of a board.
const FRAMES_BEHIND: usize = 64;

/// Publishes frames. Clones share the followers.
#[derive(Debug, Clone)]
pub struct FrameFeed {
    each: broadcast::Sender<Arc<Frame>>,
    newest: watch::Sender<Option<Arc<Frame>>>,
}

/// Where frames are followed. Clones are the same frames. A follower ends with the last feed.
#[derive(Debug, Clone)]
pub struct FrameViews {
    each: broadcast::WeakSender<Arc<Frame>>,
    newest: watch::Receiver<Option<Arc<Frame>>>,
}

/// Creates a feed and its followers' side.
pub fn frames() -> (FrameFeed, FrameViews) {
    let (each, _) = broadcast::channel(FRAMES_BEHIND);
    let (newest_in, newest) = watch::channel(None);
    let views = FrameViews { each: each.downgrade(), newest };
    (FrameFeed { each, newest: newest_in }, views)
}

impl FrameFeed {
    /// Publishes frames that have arrived together, the oldest first, without a wait for a follower.
    pub fn publish(&self, together: Vec<Arc<Frame>>) {
        let Some(newest) = together.last().cloned() else { return };
        for frame in together {
            // Without followers there is nothing to do.
            let _ = self.each.send(frame);
        }
        self.newest.send_replace(Some(newest));
    }
}

impl FrameViews {
    /// Follows each frame from now on.
    pub fn follow(&self) -> broadcast::Receiver<Arc<Frame>> {
        // Without a feed the receiver is closed.
        self.each.upgrade().map_or_else(|| broadcast::channel(1).1, |each| each.subscribe())
    }

    /// Subscribes to the newest frame; none before the first.
    pub fn newest(&self) -> watch::Receiver<Option<Arc<Frame>>> {
        self.newest.clone()
    }
}

#[cfg(test)]
mod tests {
    use tokio::sync::broadcast::error::TryRecvError;

    use super::*;
    use crate::campaign::bench::stand_in;

    fn frame(sequence: u32) -> Arc<Frame> {
        stand_in::frame(sequence, vec![0; 4])
    }

    #[test]
    fn frames_that_arrive_together_are_followed_in_their_order_and_the_newest_is_shown() {
        let (feed, views) = frames();
        feed.publish(vec![frame(1)]);
        let (mut each, newest) = (views.follow(), views.newest());
        feed.publish(vec![frame(2), frame(3), frame(4)]);
        feed.publish(Vec::new());
        let sequences: Vec<u32> =
            std::iter::from_fn(|| each.try_recv().ok()).map(|frame| frame.sequence).collect();
        assert_eq!(sequences, [2, 3, 4]);
        assert_eq!(newest.borrow().as_ref().map(|frame| frame.sequence), Some(4));
        drop(feed);
        assert_eq!(each.try_recv().unwrap_err(), TryRecvError::Closed);
        assert_eq!(views.follow().try_recv().unwrap_err(), TryRecvError::Closed);
    }
}
