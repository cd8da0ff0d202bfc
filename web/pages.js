// The pages in the order of their links: module `pages/NAME.js`, key after `g`, and what it is for.
// A new page is its module and its row. Groups: the night, the data, the rig.

export const PAGES = [
  { name: 'night', title: 'Night', key: 'n', group: 'Run', about: 'Is all well?' },
  { name: 'queue', title: 'Queue', key: 'q', group: 'Run', about: 'What comes next, and when does it end?' },
  { name: 'plan', title: 'Plan', key: 'p', group: 'Run', about: 'What will a run do, and what prevents it?' },
  { name: 'place', title: 'Place', key: 'h', group: 'Run', about: 'Manual trials: which weight goes where, now?' },
  { name: 'runs', title: 'Runs', key: 'r', group: 'Data', about: 'What happened?' },
  { name: 'trials', title: 'Trials', key: 't', group: 'Data', about: 'Show me that one.' },
  { name: 'data', title: 'Datasets', key: 'd', group: 'Data', about: 'What can I load?' },
  { name: 'model', title: 'Model', key: 'm', group: 'Touch', about: 'How does the skin behave?' },
  { name: 'nets', title: 'Nets', key: 'e', group: 'Touch', about: 'Which models are trained, and which is best?' },
  { name: 'live', title: 'Live', key: 'l', group: 'Touch', about: 'What is touching it?' },
  { name: 'rig', title: 'Rig', key: 'i', group: 'Rig', about: 'Can it move, and what is wrong with it?' },
  { name: 'wear', title: 'Wear', key: 'w', group: 'Rig', about: 'What needs care?' },
  { name: 'settings', title: 'Settings', key: 's', group: 'Rig', about: 'Who may do what?' },
]

/** The page at `/`. */
export const FIRST = 'night'
