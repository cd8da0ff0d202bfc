//! The array job of a work order, as text for Slurm's `sbatch`.
//! PURE. Uses: nothing. Never: files, Slurm.
//!
//! Task i of T makes the chunks i, i + T, i + 2 T, ..: sites limit the size of an array, and a chunk may be shorter than
//! the start of a task.

use std::fmt;

/// Name of the job's file in the folder of its work order.
pub const JOB_FILE: &str = "job.sh";
/// Folder of the output of tasks, in the folder of the work order: Slurm does not create it.
pub const JOB_LOGS: &str = "log";

/// An array job. Its paths and words need no quotes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Job {
    /// Absolute path of this program.
    pub palpate: String,
    /// Absolute path of the folder of the work order.
    pub folder: String,
    /// Absolute path of the folder whose `cache` contains solved unit responses.
    pub data: String,
    /// Start of the id of the work order.
    pub order: String,
    /// Number of chunks.
    pub chunks: u64,
    /// Number of tasks.
    pub tasks: u64,
    /// Processors of a task.
    pub cpus: usize,
    /// Further options of `sbatch`, as `name=value`.
    pub options: Vec<String>,
}

impl fmt::Display for Job {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { palpate, folder, data, order, chunks, tasks, cpus, options } = self;
        writeln!(
            f,
            "#!/bin/sh\n\
             # Written by `palpate cluster sbatch`: makes the {chunks} chunks of work order {order}.\n\
             # Submit it with: sbatch {folder}/{JOB_FILE}\n\
             #SBATCH --job-name=palpate-{order}\n\
             #SBATCH --array=0-{}\n\
             #SBATCH --output={folder}/{JOB_LOGS}/%A-%a.txt\n\
             #SBATCH --open-mode=append\n\
             #SBATCH --requeue\n\
             #SBATCH --ntasks=1\n\
             #SBATCH --cpus-per-task={cpus}",
            tasks - 1
        )?;
        for option in options {
            writeln!(f, "#SBATCH --{option}")?;
        }
        writeln!(
            f,
            "exec {palpate} cluster make {folder} --task \"$SLURM_ARRAY_TASK_ID\" --tasks {tasks} \
             --threads \"${{SLURM_CPUS_PER_TASK:-1}}\" --data {data}"
        )
    }
}

/// Number of tasks of a job's text, if this program wrote it.
pub fn tasks_of(job: &str) -> Option<u64> {
    let (_, rest) = job.lines().find(|line| line.starts_with("exec "))?.split_once(" --tasks ")?;
    rest.split(' ').next()?.parse().ok().filter(|tasks| *tasks > 0)
}

/// The tasks, ascending, that make these chunks.
pub fn tasks_for(chunks: &[u64], tasks: u64) -> Vec<u64> {
    let mut needed: Vec<u64> = chunks.iter().map(|chunk| chunk % tasks).collect();
    needed.sort_unstable();
    needed.dedup();
    needed
}

/// The chunks of one task, of `chunks` in all.
pub fn chunks_of(task: u64, tasks: u64, chunks: u64) -> impl Iterator<Item = u64> {
    (task..chunks).step_by(usize::try_from(tasks).unwrap_or(usize::MAX))
}

/// Whether a text is a limit of time as Slurm reads it: `minutes`, `hours:minutes:seconds`, `days-hours` and the forms
/// between.
pub fn is_time(text: &str) -> bool {
    let (days, rest) = match text.split_once('-') {
        Some((days, rest)) => (Some(days), rest),
        None => (None, text),
    };
    let is_number = |part: &str| !part.is_empty() && part.chars().all(|c| c.is_ascii_digit());
    days.is_none_or(is_number) && rest.split(':').count() <= 3 && rest.split(':').all(is_number)
}

/// Whether Slurm and a shell read a text as it is, without quotes.
pub fn is_plain(text: &str) -> bool {
    !text.is_empty() && text.chars().all(|c| c.is_ascii_alphanumeric() || "-_./:=,@+".contains(c))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job() -> Job {
        Job {
            palpate: "/opt/palpate".into(),
            folder: "/lab/sim".into(),
            data: "/lab/data".into(),
            order: "0123456789abcdef".into(),
            chunks: 10,
            tasks: 4,
            cpus: 2,
            options: vec!["partition=long".into(), "time=30".into()],
        }
    }

    #[test]
    fn a_job_names_its_folder_its_tasks_and_its_options() {
        let text = job().to_string();
        assert_eq!(
            text,
            "#!/bin/sh\n\
             # Written by `palpate cluster sbatch`: makes the 10 chunks of work order 0123456789abcdef.\n\
             # Submit it with: sbatch /lab/sim/job.sh\n\
             #SBATCH --job-name=palpate-0123456789abcdef\n\
             #SBATCH --array=0-3\n\
             #SBATCH --output=/lab/sim/log/%A-%a.txt\n\
             #SBATCH --open-mode=append\n\
             #SBATCH --requeue\n\
             #SBATCH --ntasks=1\n\
             #SBATCH --cpus-per-task=2\n\
             #SBATCH --partition=long\n\
             #SBATCH --time=30\n\
             exec /opt/palpate cluster make /lab/sim --task \"$SLURM_ARRAY_TASK_ID\" --tasks 4 \
             --threads \"${SLURM_CPUS_PER_TASK:-1}\" --data /lab/data\n"
        );
        assert_eq!(tasks_of(&text), Some(4));
        assert_eq!(tasks_of("#!/bin/sh\necho --tasks 4\n"), None);
    }

    #[test]
    fn each_chunk_is_made_by_one_task() {
        let mut all: Vec<u64> = (0..4).flat_map(|task| chunks_of(task, 4, 10)).collect();
        all.sort_unstable();
        assert_eq!(all, (0..10).collect::<Vec<_>>());
        assert_eq!(chunks_of(1, 4, 10).collect::<Vec<_>>(), [1, 5, 9]);
        assert_eq!(tasks_for(&[1, 2, 5, 9], 4), [1, 2]);
    }

    #[test]
    fn what_slurm_reads_is_checked() {
        for time in ["90", "90:30", "1:30:00", "2-0", "2-12:30", "2-12:30:00"] {
            assert!(is_time(time), "{time}");
        }
        for time in ["", "1h", "1:2:3:4", "-1", "1-", "1:", "1 2"] {
            assert!(!is_time(time), "{time}");
        }
        assert!(is_plain("/lab/sim-1_a.b") && is_plain("a,b@c"));
        for word in ["", "a b", "a\n#SBATCH", "a%j", "$HOME", "é"] {
            assert!(!is_plain(word), "{word}");
        }
    }
}
