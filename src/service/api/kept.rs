//! Values that are expensive to read, kept for a while: however many clients ask, each is read once.
//! Uses: tokio (its mutex and clock). Never: a value older than its age, more values than its number.

use std::time::Duration;

use tokio::sync::Mutex;
use tokio::time::Instant;

/// Multiple of the time of a reading for which its value is kept at least: readings of one kind take at
/// most a tenth of the time of one connection.
const REST: u32 = 10;

/// Kept values by their keys. Readings follow one another: a client waits for the reading of another,
/// and then gets its value.
#[derive(Debug)]
pub struct Kept<K, V> {
    age: Duration,
    most: usize,
    entries: Mutex<Vec<Entry<K, V>>>,
}

#[derive(Debug)]
struct Entry<K, V> {
    key: K,
    value: V,
    until: Instant,
}

impl<K: PartialEq, V: Clone> Kept<K, V> {
    /// Keeps at most `most` values, each for `age`, or longer if its reading took long.
    pub fn new(age: Duration, most: usize) -> Self {
        Self { age, most, entries: Mutex::default() }
    }

    /// Returns the kept value of a key, or the result of `read`, which is then kept.
    ///
    /// # Errors
    /// Those of `read`; an error is not kept.
    pub async fn get<E>(&self, key: K, read: impl Future<Output = Result<V, E>>) -> Result<V, E> {
        let mut entries = self.entries.lock().await;
        let began = Instant::now();
        if let Some(entry) = entries.iter().find(|e| e.key == key && e.until > began) {
            return Ok(entry.value.clone());
        }
        let value = read.await?;
        let ended = Instant::now();
        entries.retain(|entry| entry.key != key);
        if entries.len() >= self.most {
            entries.remove(0);
        }
        let until = ended + self.age.max(REST * (ended - began));
        entries.push(Entry { key, value: value.clone(), until });
        Ok(value)
    }

    /// Forgets the value of a key, which has changed.
    pub async fn forget(&self, key: &K) {
        self.entries.lock().await.retain(|entry| entry.key != *key);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    async fn read(kept: &Kept<u8, u32>, key: u8, value: u32) -> u32 {
        kept.get(key, async { Ok::<_, ()>(value) }).await.unwrap()
    }

    #[tokio::test]
    async fn a_value_is_kept_for_its_age_the_oldest_gives_way_and_an_error_is_not_kept() {
        let kept = Kept::new(Duration::from_secs(60), 2);
        assert_eq!(kept.get(1, async { Err::<u32, _>("failed") }).await, Err("failed"));
        assert_eq!(read(&kept, 1, 10).await, 10);
        assert_eq!(read(&kept, 1, 11).await, 10);
        assert_eq!((read(&kept, 2, 20).await, read(&kept, 3, 30).await), (20, 30));
        assert_eq!((read(&kept, 2, 21).await, read(&kept, 1, 12).await), (20, 12));
        kept.forget(&1).await;
        assert_eq!((read(&kept, 3, 31).await, read(&kept, 1, 13).await), (30, 13));
        let fleeting = Kept::new(Duration::ZERO, 2);
        assert_eq!(read(&fleeting, 1, 10).await, 10);
        tokio::time::sleep(Duration::from_millis(50)).await;
        assert_eq!(read(&fleeting, 1, 11).await, 11);
    }

    #[tokio::test]
    async fn a_slow_reading_is_kept_for_longer() {
        let kept = Kept::new(Duration::ZERO, 2);
        let slow = async {
            tokio::time::sleep(Duration::from_secs(1)).await;
            Ok::<_, ()>(1)
        };
        assert_eq!(kept.get(1, slow).await, Ok(1));
        assert_eq!(read(&kept, 1, 2).await, 1);
    }
}
