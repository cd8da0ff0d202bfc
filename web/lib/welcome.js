// The first minutes: what the service is, and one button that runs the quickstart from nothing.

import { actor } from './actions.js'
import { beginRun, queueCarried } from './begin.js'
import { carried } from './carried.js'
import { el, fill, link, panel } from './dom.js'
import { counted } from './format.js'
import { live } from './live.js'

const QUICKSTART = 'quickstart'

/** Makes the panel of an empty service. `queued` is the first run of the queue, or null. */
export function welcome({ said }) {
  const steps = el('ol', { className: 'steps' }), offer = el('div')
  const node = panel('Welcome', { className: 'welcome' },
    el('p', { className: 'big' }, 'Palpate presses a tactile skin with a rig, overnight, and stores what the skin answers.'),
    el('p', {}, 'No run is stored here yet. The quickstart is a small campaign that shows all parts.'), steps, offer, said.node,
    el('p', { className: 'soft' }, 'Other experiments, or a file of your own: ', link('/queue', 'the queue'), '. What the rig reports: ', link('/rig',
      'the rig'), '.'))
  let made = null, trials = null, shown = '', next = null
  const tell = () => {
    const queued = next
    const isVirtual = live.status?.rig.label === 'virtual', what = queued ? `Run ${queued.scan_id}, ${queued.experiment}, is` : 'The quickstart is queued,'
    const size = queued?.trials_planned ?? trials
    fill(steps, [
      isVirtual ? 'The wires to the virtual rig are opened and its axes are homed, if they are not.'
        : 'The wires are opened and the axes of the rig are homed: keep hands and tools away from it.',
      `${what} checked, armed and started${size ? `: ${counted(size, 'trial')}` : ''}.`,
      `The run waits when tips must be mounted, and this page says so${isVirtual ? '; the virtual operator, if one runs, mounts them' : ''}.`,
    ].map(words => el('li', {}, words)))
  }
  // A second press after a refusal arms the run that the first one queued.
  const begin = async queued => {
    if (!queued && !made) said.tell('Queuing the quickstart …')
    made = queued ?? made ?? await queueCarried(QUICKSTART)
    return beginRun(made, said, { ask: live.status?.rig.label !== 'virtual' })
  }
  return {
    node,
    async show(queued) {
      const key = [queued?.uid, live.may('operator'), live.status?.rig.label].join()
      if (key === shown) return
      shown = key
      const words = queued ? `Arm and start ${queued.experiment}` : 'Run the quickstart'
      fill(offer, el('div', { className: 'row' }, actor(words, quiet(said), () => begin(queued), { className: 'main large' })),
        !live.may('operator') && el('p', { className: 'soft' }, 'Starting needs a key with the role operator: see ', link('/settings', 'the settings'), '.'))
      next = queued
      tell()
      if (trials == null) {
        trials = await carried().then(items => items.find(item => item.name === QUICKSTART)?.trials ?? null, () => null)
        tell() // Of the run that is next by then.
      }
    },
  }
}

// `beginRun` tells each step and its result; only a failure before it is told here.
const quiet = said => ({ ...said, run: (words, work) => work().catch(error => said.tell(`${words}: ${error.message}`, 'bad')) })
