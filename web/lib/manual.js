// Manual trials before they begin: what they are, the overlay to print, and the experiment to queue.

import { all } from './api.js'
import { actor } from './actions.js'
import { beginButton, queueText } from './begin.js'
import { carried } from './carried.js'
import { el, fill, link, panel, say } from './dom.js'
import { count, moment } from './format.js'
import { overlay } from './overlay.js'
import { kilograms } from './placing.js'
import { table } from './table.js'

const STEPS = [
  'Print the overlay at true scale, check its 100 mm ruler, and fix it on the skin: its labels name the points.',
  'Prepare the weights of the experiment, each on a tip: the table next to this states them.',
  'Queue the experiment, arm and start it. The service draws the points and the weights; the same seed draws the same ones.',
  'For each trial this page shows which weight goes where. Place all of them, take your hands off, press Done: a key or a foot switch is enough.',
  'The skin feels what was placed. A weight on the wrong point is reported before it is stored. You may stop at any time: the run continues where it stopped.',
]

const isManual = item => item.kind === 'real-random'

/** Makes the page for when no weights are asked; `load()` reads the queue again. */
export function manual(said, { signal }) {
  const queued = el('div'), offered = el('div'), reason = el('p', { className: 'state' }), follows = el('p', { className: 'soft' })
  const node = el('div', { className: 'page' },
    el('section', { className: 'live', 'aria-label': 'Now' }, reason, follows),
    el('div', { className: 'columns two' },
      panel('How manual trials go', {}, el('ol', { className: 'steps' }, STEPS.map(words => el('li', {}, words)))),
      el('div', { className: 'column' }, panel('Begin', {}, queued, offered, said.node), panel('Overlay to print', {},
        el('p', {}, 'All points of the skin with their labels, its outline and its electrodes, at true scale.'), overlay(),
          el('p', { className: 'soft small' }, 'Print at 100 %, without "fit to page", and measure the ruler before you cut.')))))

  async function load() {
    const waiting = (await all('/queue', {}, { signal }).catch(() => [])).filter(run => run.kind === 'real-random')
    fill(queued, waiting.map(run => el('div', { className: 'row' },
      el('span', {}, `Run ${run.scan_id}, ${run.experiment}: ${count(run.trials_planned)} trials, queued ${moment(run.created_at)}.`),
      beginButton('Arm and start', run, said, { className: 'main' }))))
    const items = await carried().then(found => found.filter(isManual), error => error)
    if (!Array.isArray(items)) return fill(offered, el('p', { className: 'soft' },
      `The carried experiments could not be read (${items.message}). A file can be queued on `, link('/queue', 'the queue'), '.'))
    const put = item => queueText(item.file, item.text).then(load)
    const rows = table({
      rows: items, empty: 'No carried experiment is a manual one.',
      columns: [{ head: 'Experiment', cell: item => item.name }, { head: 'What it is', left: true, cell: item => item.about },
        { head: 'Trials', cell: item => count(item.trials) }, { head: 'Weights', cell: item => item.weights_n.map(kilograms).join(', ') },
        { head: 'Queue', cell: item => actor('Queue it', said, () => put(item),
          { what: `${item.name} queued`, className: `nowrap${waiting.length || item !== items[0] ? '' : ' main'}` }) }],
    })
    return fill(offered, rows.node)
  }
  /** Says why no weights are asked. */
  const tell = run => {
    say(reason, run ? `Run ${run.scan_id} wants no weights now` : 'No run waits for weights')
    say(follows, run ? `${run.experiment} is ${run.state}${run.waiting_for ? `: ${run.waiting_for}` : ''}. When a run waits for weights, they appear here.`
      : 'When a manual run is started, its first placement appears here by itself.')
  }
  return { node, load, tell }
}
