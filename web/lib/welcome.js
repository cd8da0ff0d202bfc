// The first minutes: what the service is, and one button that runs the quickstart from nothing.

import { actor } from './actions.js'
import { beginRun, queueCarried } from './begin.js'
import { el, fill, link, panel } from './dom.js'
import { counted } from './format.js'
import { live } from './live.js'
import { get } from './api.js'

const QUICKSTART = 'quickstart'

/** Makes the panel of an empty service. `queued` is the first run of the queue, or null. */
export function welcome({ said }) {
  const steps = el('ol', { className: 'steps' }), offer = el('div')
  const node = panel('Welcome', { className: 'welcome' },
    el('p', { className: 'big' }, 'Palpate presses a tactile skin with a rig, overnight, and stores what the skin answers.'),
    el('p', {}, 'No run is stored here yet. The quickstart is a small campaign that shows all parts.'), steps, offer, said.node,
    el('p', { className: 'soft' }, 'Other experiments, or a file of your own: ', link('/queue', 'the queue'), '. What the rig reports: ', link('/rig',
      'the rig'), '.'))
  const says = async () => {
    const { items } = await get('/experiments').catch(() => ({ items: [] })), trials = items.find(item => item.name === QUICKSTART)?.trials
    const isVirtual = live.status?.rig.label === 'virtual'
    fill(steps, [
      isVirtual ? 'The wires to the virtual rig are opened and its axes are homed, if they are not.'
        : 'The wires are opened and the axes of the rig are homed: keep hands and tools away from it.',
      `The quickstart is queued, checked, armed and started${trials ? `: ${counted(trials, 'trial')}, with one tip and then with four` : ''}.`,
      `The run waits when tips must be mounted, and this page says so${isVirtual ? '; the virtual operator, if one runs, mounts them' : ''}.`,
    ].map(words => el('li', {}, words)))
  }
  return {
    node,
    show(queued) {
      says()
      const work = async () => {
        said.tell('Queuing the quickstart …')
        return beginRun(queued ?? await queueCarried(QUICKSTART), said, { ask: live.status?.rig.label !== 'virtual' })
      }
      fill(offer, el('div', { className: 'row' }, actor(queued ? `Arm and start ${queued.experiment}` : 'Run the quickstart', quiet(said), work,
        { className: 'main large' })))
    },
  }
}

// `beginRun` tells each step and its result; only a failure before it is told here.
const quiet = said => ({ run: (words, work) => work().catch(error => said.tell(`${words}: ${error.message}`, 'bad')) })
