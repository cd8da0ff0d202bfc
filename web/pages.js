// The pages in the order of their links: module `pages/NAME.js`, key after `g`, and what it is for.
// A new page is its module and its row. Groups: the night, the data, the rig. What a page shows is for the table in
// docs/how-to/dashboard.md, which a test writes.

export const PAGES = [
  { name: 'night', title: 'Night', key: 'n', group: 'Run', about: 'Is all well?',
    shows: 'the tour on the skin, forces of every sample, the live frame and its twin, what may suspend the run, trials per hour, states, predictions, events' },
  { name: 'queue', title: 'Queue', key: 'q', group: 'Run', about: 'What comes next, and when does it end?',
    shows: 'order, start times, an editor for experiment files: choose a carried one, or drop a file on the page' },
  { name: 'plan', title: 'Plan', key: 'p', group: 'Run', about: 'What will a run do, and what prevents it?',
    shows: 'the tour step by step, time by activity, problems, also of a carried experiment that is not queued; arm and start' },
  { name: 'place', title: 'Place', key: 'h', group: 'Run', about: 'Manual trials: which weight goes where, now?',
    shows: 'the placement that the run awaits, and its verdict: [manual trials](manual-trials.md)' },
  { name: 'runs', title: 'Runs', key: 'r', group: 'Data', about: 'What happened?',
    shows: 'any selection of runs; results, two runs side by side' },
  { name: 'trials', title: 'Trials', key: 't', group: 'Data', about: 'Show me that one.',
    shows: 'any selection of trials; one trial with its frame, twin and forces' },
  { name: 'data', title: 'Datasets', key: 'd', group: 'Data', about: 'What can I load?',
    shows: 'counts as in Table I, lineage down to a frame, files, lines to copy' },
  { name: 'model', title: 'Model', key: 'm', group: 'Touch', about: 'How does the skin behave?',
    shows: 'contacts placed with the mouse: dent, voltages; Fig. 7 of a run' },
  { name: 'nets', title: 'Nets', key: 'e', group: 'Touch', about: 'Which models are trained, and which is best?',
    shows: 'losses, tables, promotion' },
  { name: 'live', title: 'Live', key: 'l', group: 'Touch', about: 'What is touching it?',
    shows: 'contacts with their uncertainty, other explanations, and quantities, frame by frame' },
  { name: 'rig', title: 'Rig', key: 'i', group: 'Rig', about: 'Can it move, and what is wrong with it?',
    shows: 'devices from wire to tip, home, jog, tare, check' },
  { name: 'wear', title: 'Wear', key: 'w', group: 'Rig', about: 'What needs care?',
    shows: 'presses per place, travel' },
  { name: 'settings', title: 'Settings', key: 's', group: 'Rig', about: 'Who may do what?',
    shows: 'your name, keys, the operator lock, the log of actions' },
]

/** The page at `/`. */
export const FIRST = 'night'
