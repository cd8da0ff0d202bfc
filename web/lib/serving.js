// What serves: the slots of the methods and of quantities, promotion and roll-back, and the record of both.

import { ask, once } from './api.js'
import { actor, confirm, only } from './actions.js'
import { el, link, note, panel } from './dom.js'
import { fold } from './fold.js'
import { capital, listed, moment } from './format.js'
import { who } from './live.js'
import { isOfQuantity, slotOf } from './serves.js'
import { table } from './table.js'

/** paper: measured to simulated voltages; without a method: position of one contact, from a whole frame */
function useOf(name) {
  const { methods, about } = slotOf(name)
  return listed([methods.join(', '), about], ': ')
}

/** Makes the panel; `name(id)` gives a model's name. `promotion(model, props)` makes the button that promotes one. */
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
      { head: 'Change', cell: one => (one.what ? rollBack(one) : '') },
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
  const words = id => {
    if (id == null) return el('span', { className: 'soft' }, 'nothing')
    return id.startsWith('mdl-') ? el('span', {}, link(`/nets?model=${id}`, name(id)), ' ', el('span', { className: 'soft small' }, id)) : id
  }
  /** Changes what serves, if it still has the entity tag `tag`: that of what the person saw at the press. */
  const change = (path, body, tag) =>
    once(path, { ...body, who: who() }, { headers: tag ? { 'if-match': tag } : {}, wait: 120_000 }).finally(async () => {
      await read()
      onchange()
    })
  const since = of => history.find(one => one.slot === of.slot && one.sensor === (of.sensor ?? sensor))
  const title = of => slotOf(of.slot).title + (of.sensor ? ` of ${of.sensor}` : '')
  function rollBack(of) {
    const { what: now, restores: to } = of
    const words = () => [
      `Serves now: ${name(now)} (${now}).`,
      to ? `${name(to)} (${to}) serves again.` : 'Nothing served before it: the slot becomes empty.',
      'It is loaded before it serves: no frame is dropped.',
    ]
    return actor('Roll back', said, tag => change('/serving/roll-back', { slot: of.slot, sensor: of.sensor }, tag), {
      what: `Roll back ${of.slot}`,
      'aria-label': `Roll back ${title(of)}`,
      seen: () => etag,
      sure: () => confirm(`Roll back ${title(of)}?`, words(), 'Roll back'),
    })
  }
  function surePromotion(what, slot, of = sensor) {
    const now = [...serves, ...elsewhere].find(one => one.slot === slot && (one.sensor ?? sensor) === of)?.what
    const uses = isOfQuantity(slotOf(slot)) ? 'Live quantities use' : 'Live contacts and /infer use'
    return confirm(
      `Promote ${name(what)}?`,
      [
        `Slot: ${slotOf(slot).title} (${useOf(slot)}).`,
        now ? `It replaces ${name(now)} (${now}), which roll back restores.` : 'The slot is empty now.',
        `${of === sensor ? uses : `Requests that name ${slot}@${of} use`} it from the next frame on. It is loaded and warmed up first: no frame is dropped.`,
      ],
      'Promote'
    )
  }
  const promotion = (model, props) =>
    actor('Promote', said, tag => change('/serving', { what: model.id }, tag), {
      what: `Promote ${model.name}`,
      seen: () => etag,
      sure: () => surePromotion(model.id, model.slot, model.manifest.sensor),
      ...props,
    })
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
      const before = etag
      etag = answer.headers.get('etag')
      ;({ sensor, serves, elsewhere, history } = found)
      note(trouble, '')
      if (etag !== before) draw() // A button that is pressed stays.
    } catch (error) {
      if (!signal.aborted && mine === asked) note(trouble, `The active models cannot be read: ${error.message}`)
    }
  }

  // A calibration is a file: it is added here, and promoted by its id.
  const file = el('input', { id: 'cal-file', type: 'file', accept: '.toml,.txt' })
  const add = actor('Add and promote', said, async () => {
    if (!file.files[0]) throw new Error('choose the file that palpate calibrate skin wrote')
    const id = await (
      await ask('/api/v1/calibrations', { method: 'POST', body: new Blob([await file.files[0].text()], { type: 'text/plain' }), wait: 30_000 })
    ).json()
    const tag = etag
    if (await surePromotion(id, 'skin')) await change('/serving', { what: id }, tag)
  }, { what: 'Add the calibration' })
  const node = panel('Active models', { className: 'live' },
    trouble,
    slots.node,
    fold('promotions', 'History of promotions', { signal }, past.node),
    only(
      'operator',
      fold('calibration', 'Add a calibration of the skin', { signal },
        el('label', { htmlFor: 'cal-file' }, 'File of palpate calibrate skin'),
        file,
        el('div', { className: 'row' }, add)
      )
    )
  )
  return { node, read, draw, promotion }
}
