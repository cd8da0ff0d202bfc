// Selections of runs and trials: conditions of the address; those of trials as controls, all others as chips.

import { button, choose, el, field, fill, panel, renew, select } from './dom.js'
import { plain } from './format.js'
import { vocabulary } from './vocabulary.js'

/** Parameters of a page that are no condition: what is opened and how it is drawn, apart from its charts and folds. */
const OWN = { trials: ['trial', 'sort', 'scale'], runs: ['run', 'with', 'from', 'to', 'night', 'event', 'colour', 'step', 'log'] }
const COMPARES = { eq: '=', gt: '>', gte: '≥', lt: '<', lte: '≤', in: 'one of' }

/** The conditions of the address of a page, `trials` or `runs`, as the API takes them. */
export function conditions(query, page = 'trials') {
  return Object.fromEntries(Object.entries(query).filter(([key, value]) => value !== '' && !OWN[page].includes(key) && !/^(zoom|hide|open)-/.test(key)))
}

/** A condition as text: `fvu__gte`, 0.5 -> "FVU ≥ 0.5". */
function conditionWords(key, value) {
  const [column, compare = 'eq'] = key.split('__')
  return key === 'where' ? value : `${plain(column)} ${COMPARES[compare] ?? compare} ${value}`
}

/** Makes a button for each condition, which removes it, and one that removes all; `also` is changed with them. */
export function chips(rest, all, set, also = {}) {
  const chip = ([key, value]) =>
    button(`${conditionWords(key, value)} ×`, () => set({ ...also, [key]: null }), {
      className: 'chip',
      'aria-label': `Remove the condition ${conditionWords(key, value)}`,
    })
  return [
    rest.map(chip),
    all.length > 0 && button('Clear all', () => set({ ...also, ...Object.fromEntries(all.map(([key]) => [key, null])) }), { className: 'plain' }),
  ]
}

/**
 * Makes the controls. `set(changes)` puts them into the address; `show(query, runs)` shows what the
 * address has. A condition without a control is a chip that a click removes.
 */
export function selection({ set, said }) {
  const change = key => value => set({ [key]: value || null, trial: null })
  const controls = {} // By the condition that each sets.
  const labelled = (words, node) => field(words, node, `f-${words.toLowerCase().replace(/[^a-z]+/g, '-')}`)
  const condition = (words, node) => {
    controls[node.name] = node
    return labelled(words, node)
  }
  const number = (key, props = {}) =>
    el('input', { type: 'number', step: 'any', inputMode: 'decimal', name: key, ...props, onchange: event => change(key)(event.target.value) })
  const choice = (key, choices) => select(choices, '', change(key), { name: key })
  const counts = [['', 'any'], ['0', 'none'], ...[1, 2, 3, 4, 5, 6].map(n => [String(n), String(n)])]
  const each = vocabulary.flags.map(({ name }) => [`flag=${name}`, plain(name)])
  const flags = select([['', 'any'], ['flagged=true', 'with a flag'], ['flagged=false', 'without a flag'], ...each], '', value => {
    const [key, wanted] = value.split('=')
    set({ flag: null, flagged: null, trial: null, ...(key && { [key]: wanted }) })
  })
  const order = select([['', 'newest first'], ['trial_id', 'oldest first']], '', value => set({ sort: value || null }))
  const others = el('div', { className: 'chips', role: 'group', 'aria-label': 'Conditions' })
  const form = el('div', { className: 'form' },
    condition('Run', choice('scan_id', [['', 'all']])),
    condition('Contacts', choice('contact_count', counts)),
    condition('Largest force from, N', number('max_force_n__gte')),
    condition('to, N', number('max_force_n__lte')),
    condition('Depth from, mm', number('depth_mm__gte', { min: 0 })),
    condition('to, mm', number('depth_mm__lte', { min: 0 })),
    condition('FVU at least', number('fvu__gte', { min: 0 })),
    labelled('Flags', flags),
    condition('Label', choice('label', [['', 'any'], 'measured', 'virtual'])),
    labelled('Order', order)
  )
  const node = panel('Selection', {}, form, others, said)
  return {
    node,
    show(query, runs) {
      renew(controls.scan_id, runs.map(run => run.uid), () => [
        el('option', { value: '' }, 'all'),
        runs.map(run => el('option', { value: String(run.scan_id) }, `${run.scan_id} · ${run.experiment}`)),
      ])
      for (const [key, control] of Object.entries(controls)) {
        const value = query[key] ?? ''
        if (control.tagName === 'SELECT') choose(control, value)
        else if (document.activeElement !== control) control.value = value
      }
      flags.value = query.flag ? `flag=${query.flag}` : query.flagged ? `flagged=${query.flagged}` : ''
      order.value = query.sort === 'trial_id' ? 'trial_id' : ''
      const all = Object.entries(conditions(query))
      const rest = all.filter(([key]) => !(key in controls) && !['flag', 'flagged'].includes(key))
      fill(others, chips(rest, all, set, { trial: null }))
    },
  }
}
