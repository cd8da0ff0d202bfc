// Losses of a training as curves: from a model, or polled while a training runs.

import { Refused, ask, rowsOf } from './api.js'
import { chart } from './chart.js'
import { el, note, sleep } from './dom.js'
import { counted, span } from './format.js'

/**
 * Makes the curves of `/models/ID/losses` or `/jobs/ID/losses`. `live()`: whether it is read again
 * each 2 s. `key` is unique in its page: its zoom is in the address. Ends with `signal`.
 */
export function losses({ path, key = 'losses', label, signal, live = () => false }) {
  const said = el('p', { className: 'soft small' }),
    curves = chart({
      title: 'Losses over epochs',
      key,
      x: 'Epoch',
      y: 'Loss',
      time: false,
      whole: true,
      height: 240,
      label,
      signal,
      log: true,
      query: `/api/v1${path}`,
      series: [
        { name: 'train', digits: 5, colour: '--c2', points: true },
        { name: 'validation', digits: 5, colour: '--c3', points: true },
      ],
    })
  const node = el('div', {}, curves.node, said)
  // A logarithmic scale has no place for zero.
  const above = value => (value > 0 ? value : null)
  async function show() {
    try {
      const rows = await rowsOf(await ask(`/api/v1${path}`, { accept: 'application/x-ndjson', signal }))
      curves.set([rows.map(row => row.epoch), rows.map(row => above(row.train_loss)), rows.map(row => above(row.validation_loss))])
      const last = rows.at(-1),
        best = rows.reduce((a, b) => (a && a.validation_loss <= b.validation_loss ? a : b), null)
      const end = live() ? ' so far' : '; the model has the weights of that epoch',
        least = best?.validation_loss.toPrecision(4)
      curves.node.hidden = rows.length === 0
      const none = live() ? 'No epoch has ended yet.' : 'No losses are stored: the model was added from a file.'
      note(said, last ? `${counted(last.epoch, 'epoch')} in ${span(last.elapsed_s)}. Best validation loss: ${least} after epoch ${best.epoch}${end}.` : none)
    } catch (error) {
      if (signal.aborted) return
      curves.node.hidden = true
      note(said, error instanceof Refused ? `No losses: ${error.message}` : 'The losses could not be read.')
    }
  }
  async function watch() {
    await show()
    while (!signal.aborted && live()) {
      await sleep(2000, signal)
      if (!signal.aborted && !document.hidden) await show()
    }
  }
  watch()
  return { node }
}
