// What serves: the slots of the methods and of quantities, promotion and roll-back, and the record of both.

import { ask, once } from './api.js'
import { actor, confirm, named, only } from './actions.js'
import { button, el, link, note, panel } from './dom.js'
import { fold } from './fold.js'
import { capital, moment } from './format.js'
import { who } from './live.js'
import { lockWords } from './lock.js'
import { isOfQuantity, slotOf } from './serves.js'
import { table } from './table.js'

/** paper: measured to simulated voltages; without a method: position of one contact, from a whole frame */
function useOf(name) {
  const { methods, about } = slotOf(name)
  return [methods.join(', '), about].filter(Boolean).join(': ')
}

/** Makes the panel; `name(id)` gives a model's name. `promote(what, slot, sensor)` asks first; without a sensor: the rig's. */
export function servingPanel({ signal, said, name, onchange }) {
  let etag = null,
    sensor = '',
    serves = [],
    elsewhere = [],
    history = []
  const slots = table({
    empty: '',
    columns: [
      { head: 'Slot', left: true, cell: one => capital(title(one)) },
      { head: 'Used by', left: true, cell: one => useOf(one.slot) },
      { head: 'Serves', left: true, cell: one => words(one.what) },
      { head: 'Since', left: true, cell: one => (!one.what ? '' : since(one) ? `${moment(since(one).at)} by ${since(one).who}` : null) },
      {
        head: 'Change',
        cell: one => (one.what ? only('operator', button('Roll back', () => rollBack(one), { 'aria-label': `Roll back ${title(one)}` })) : ''),
      },
    ],
  })
  const past = table({
    empty: 'Nothing was promoted yet.',
    columns: [
      { head: 'When', left: true, cell: one => moment(one.at, true) },
      { head: 'What', left: true, cell: one => (one.rolled_back ? `rolled back to ${one.what ?? 'nothing'}` : `promoted ${one.what}`) },
      { head: 'Slot', left: true, cell: one => (one.sensor === sensor ? one.slot : `${one.slot}@${one.sensor}`) },
      { head: 'Who', left: true, cell: one => one.who },
      { head: 'Why', left: true, cell: one => one.why },
    ],
  })
  const trouble = el('p', { className: 'bad', hidden: true })
  const words = id =>
    id == null
      ? el('span', { className: 'soft' }, 'nothing')
      : id.startsWith('mdl-')
        ? el('span', {}, link(`/nets?model=${id}`, name(id)), ' ', el('span', { className: 'soft small' }, id))
        : id
  const change = async (what, path, body) => {
    await said.run(what, () => once(path, { ...body, who: who() }, { headers: etag ? { 'if-match': etag } : {}, wait: 120_000 }))
    await read()
    onchange()
  }
  const since = of => history.find(one => one.slot === of.slot && one.sensor === (of.sensor ?? sensor))
  const title = of => slotOf(of.slot).title + (of.sensor ? ` of ${of.sensor}` : '')
  async function rollBack(of) {
    if (lockWords()) return void said.tell(lockWords(), 'warn')
    const { what: now, restores: to } = of
    const sure = await confirm(
      `Roll back ${title(of)}?`,
      [
        `Serves now: ${name(now)} (${now}).`,
        to ? `${name(to)} (${to}) serves again.` : 'Nothing served before it: the slot becomes empty.',
        'It is loaded before it serves: no frame is dropped.',
      ],
      'Roll back'
    )
    if (sure && (await named())) change(`Roll back ${of.slot}`, '/serving/roll-back', { slot: of.slot, sensor: of.sensor })
  }
  async function promote(what, slot, of = sensor) {
    if (lockWords()) return void said.tell(lockWords(), 'warn')
    const now = [...serves, ...elsewhere].find(one => one.slot === slot && (one.sensor ?? sensor) === of)?.what
    const uses = isOfQuantity(slotOf(slot)) ? 'Live quantities use' : 'Live contacts and /infer use'
    const sure = await confirm(
      `Promote ${name(what)}?`,
      [
        `Slot: ${slotOf(slot).title} (${useOf(slot)}).`,
        now ? `It replaces ${name(now)} (${now}), which roll back restores.` : 'The slot is empty now.',
        `${of === sensor ? uses : `Requests that name ${slot}@${of} use`} it from the next frame on. It is loaded and warmed up first: no frame is dropped.`,
      ],
      'Promote'
    )
    if (sure && (await named())) await change(`Promote ${name(what)}`, '/serving', { what })
  }
  function draw() {
    slots.show([...serves, ...elsewhere])
    past.show(history.slice(0, 20))
  }
  let asked = 0
  async function read() {
    const mine = (asked += 1)
    try {
      const answer = await ask('/api/v1/serving', { signal })
      const found = await answer.json()
      if (mine !== asked) return // What was asked later, as after a promotion, is newer.
      etag = answer.headers.get('etag')
      ;({ sensor, serves, elsewhere, history } = found)
      note(trouble, '')
      draw()
    } catch (error) {
      if (!signal.aborted && mine === asked) note(trouble, `The active models cannot be read: ${error.message}`)
    }
  }

  // A calibration is a file: it is added here, and promoted by its id.
  const file = el('input', { id: 'cal-file', type: 'file', accept: '.toml,.txt' })
  const add = actor(
    'Add and promote',
    said,
    async () => {
      if (!file.files[0]) throw new Error('choose the file that palpate calibrate skin wrote')
      const id = await (
        await ask('/api/v1/calibrations', { method: 'POST', body: new Blob([await file.files[0].text()], { type: 'text/plain' }), wait: 30_000 })
      ).json()
      await promote(id, 'skin')
      return id
    },
    { what: 'Add the calibration' }
  )
  const node = panel(
    'Active models',
    { className: 'live' },
    trouble,
    slots.node,
    fold('promotions', 'History of promotions', { signal }, past.node),
    only(
      'operator',
      fold(
        'calibration',
        'Add a calibration of the skin',
        { signal },
        el('label', { htmlFor: 'cal-file' }, 'File of palpate calibrate skin'),
        file,
        el('div', { className: 'row' }, add)
      )
    )
  )
  return { node, read, draw, promote }
}
