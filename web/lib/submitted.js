// The tour of an experiment that is not queued, as the service plans it. The plan and the editor draw it.

import { send } from './api.js'
import { el, fill } from './dom.js'
import { rigLabel } from './live.js'
import { tourView } from './tour.js'

/** Asks for the tour, with its sensor, of a submission { file, definition, sensor }. */
export const submittedTour = (submission, signal) => send('/tour', submission, { signal })

/** Makes the part of a page that plans and draws the tour once it is opened, or at once if `open`. */
export function tourPart(submission, signal, open = false) {
  const place = el('div')
  let asked = false
  const node = el('details', { open }, el('summary', {}, 'Tour over the skin'), place)
  node.addEventListener('toggle', async () => {
    if (!node.open || asked) return
    asked = true
    fill(place, el('p', { className: 'soft' }, 'Planning …'))
    try {
      const tour = await submittedTour(submission, signal)
      if (signal.aborted) return
      const view = tourView({ onstep: () => {}, label: rigLabel, signal })
      fill(place, view.node)
      view.show(tour, tour.sensor)
    } catch (error) {
      asked = false
      if (!signal.aborted) fill(place, el('p', { className: 'bad' }, `The tour could not be read: ${error.message}. Close this part and open it to try again.`))
    }
  })
  return node
}
