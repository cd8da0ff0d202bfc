//! The commit from which the program was built, stored with every run, twin, dataset and model.
//! Uses: nothing. Never: git (the build script of the program reads it and sets it here).

use std::sync::OnceLock;

static COMMIT: OnceLock<&'static str> = OnceLock::new();

/// Sets the commit once, at the start of the program. An empty one is none: an image is built with that of its
/// command line.
pub fn set(commit: Option<&'static str>) {
    if let Some(commit) = commit.filter(|commit| !commit.is_empty()) {
        // A second call changes nothing.
        let _ = COMMIT.set(commit);
    }
}

/// Returns the commit, with `-dirty` if files were changed; none if it was built without git.
pub fn known() -> Option<&'static str> {
    COMMIT.get().copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_commit_is_not_known() {
        set(Some(""));
        assert_eq!(known(), None);
    }
}
