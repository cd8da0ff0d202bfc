// A form for an experiment file: one input for each key in the text, with unit, limits and meaning from the schema.
// Writes into the text and reads from it: the text is what is sent.

import { button, el, field, fill, note, select } from './dom.js'
import { capital, count, listed, plain } from './format.js'
import { entries, kindOf, plainValue, put, written } from './toml.js'

const UNITS = { mm: 'mm', n: 'N', ms: 'ms', s: 's', v: 'V', pitches: 'pitches', fvu: '' }
const TABLES = {
  '': 'Experiment',
  real_hex: 'Presses by the indenter',
  real_random: 'Weights placed manually',
  measure: 'Measurement',
  policy: 'Retries and resumes',
  twins: 'Simulated twins',
  limits: 'Force limits',
}

const nameOf = table => TABLES[table] ?? plain(table)
/** Unit of a key, by its name. */
const unitOf = key => UNITS[key.split('_').at(-1)] ?? ''
/** Name of a key in words, with its unit in brackets instead of its suffix. */
const word = key => (unitOf(key) ? `${plain(key.slice(0, key.lastIndexOf('_')))} (${unitOf(key)})` : plain(key))
const of = (schema, table, key) => (table ? schema?.properties?.[table] : schema)?.properties?.[key]

function rangeOf({ minimum: low, maximum: high, exclusiveMinimum: above }) {
  if (low != null && high != null && high <= 1e15) return `${count(low)} to ${count(high)}`
  return low != null ? `at least ${low}` : above != null && `above ${above}`
}

/** Limits and default of a key, as words. */
function limits(rule) {
  if (!rule) return ''
  const one = rule.type === 'array' ? (rule.items ?? {}) : rule
  const words = listed([rangeOf(one), rule.default != null && `default ${JSON.stringify(rule.default).replaceAll(',', ', ')}`], '; ')
  return words && `${capital(words)}.`
}

/**
 * Makes the form. `onchange(text)` gets the new text after each change; `show(text, problems)` shows a
 * text, and problems { key, value, limit } next to their keys; it returns the problems of other keys.
 */
export function fields({ schema, onchange }) {
  const node = el('div', { className: 'fields' })
  let text = ''
  let inputs = new Map()
  const change = next => {
    text = next
    onchange(next)
  }

  function entry({ table, key, raw }) {
    const name = listed([table, key], '.')
    const id = `key-${name.replace('.', '-')}`
    const rule = of(schema, table, key)
    const kind = kindOf(raw)
    const whole = [rule?.type].flat().includes('integer')
    const typed = value => change(put(text, table, key, written(kind, value)))
    const about = rule?.description?.split('\n')[0] ?? ''
    const control =
      kind === 'boolean'
        ? select([['true', 'yes'], ['false', 'no']], raw, typed, { id })
        : el('input', {
            id,
            oninput: event => typed(event.target.value),
            autocomplete: 'off',
            spellcheck: false,
            ...(kind === 'number' && { type: 'number', step: whole ? 1 : 'any', min: rule?.minimum, max: rule?.maximum > 1e15 ? null : rule?.maximum }),
          })
    const bad = el('p', { className: 'bad small', id: `${id}-bad`, hidden: true })
    const hint = el('p', { className: 'soft small', id: `${id}-hint` }, listed([about, limits(rule)], ' '))
    control.setAttribute('aria-describedby', `${id}-hint ${id}-bad`)
    const optional = schema && rule && !(table ? schema.properties[table] : schema).required?.includes(key)
    inputs.set(name, { control, bad })
    return el('div', {},
      el('div', { className: 'field-head' },
        el('label', { htmlFor: id }, word(key)),
        optional &&
          button('Remove', () => change(put(text, table, key, null)), { className: 'plain small', 'aria-label': `Remove ${name}: the default applies` }),
      ),
      control,
      bad,
      hint,
    )
  }

  // Keys that the schema has and the text does not: one select for a table that is there, one for all others.
  const absent = (table, present) =>
    Object.entries((table ? schema?.properties?.[table] : schema)?.properties ?? {}).filter(([key, rule]) => !rule.properties && !present.has(key))
  const first = rule => rule.default ?? rule.minimum ?? (rule.type === 'array' ? [1] : [rule.type].flat().includes('string') ? '' : 0)
  function more(id, tables) {
    if (!tables.some(([, keys]) => keys.length)) return null
    const add = event => {
      const [table, key] = event.target.value.split('.')
      const rule = of(schema, table, key)
      if (rule) change(put(text, table, key, JSON.stringify(first(rule))))
    }
    const options = (table, keys) => keys.map(([key]) => el('option', { value: `${table}.${key}` }, word(key)))
    const groups =
      tables.length === 1
        ? options(...tables[0])
        : tables.map(([table, keys]) => el('optgroup', { label: nameOf(table) }, options(table, keys)))
    return field('Another key', el('select', { onchange: add }, el('option', { value: '' }, 'defaults apply'), groups), id)
  }

  function build(found) {
    inputs = new Map()
    const tables = [...new Set(['', ...found.map(e => e.table)])]
    const others = Object.keys(schema?.properties ?? {}).filter(
      key => schema.properties[key].properties && !['real_hex', 'real_random', ...tables].includes(key),
    )
    const part = (title, about, ...inside) =>
      el('fieldset', {}, el('legend', {}, title), about && el('p', { className: 'soft small' }, about), el('div', { className: 'form' }, inside))
    fill(node,
      tables.map(table => {
        const here = found.filter(e => e.table === table)
        const keys = absent(table, new Set(here.map(e => e.key)))
        return part(nameOf(table), table && schema?.properties?.[table]?.description, here.map(entry), more(`more-${table || 'file'}`, [[table, keys]]))
      }),
      others.length > 0 &&
        part(
          'All else',
          `${others.map(nameOf).join(', ')}: the default values apply.`,
          more('more-others', others.map(table => [table, absent(table, new Set())])),
        ),
    )
  }

  let shape = ''
  function show(next, problems = []) {
    text = next
    const found = entries(next)
    const names = found.map(e => `${e.table}.${e.key}:${kindOf(e.raw)}`).join()
    if (names !== shape) {
      shape = names
      build(found)
    }
    for (const { table, key, raw } of found) {
      const { control } = inputs.get(listed([table, key], '.'))
      if (control !== document.activeElement || control.tagName === 'SELECT') control.value = plainValue(raw)
    }
    for (const [name, { control, bad }] of inputs) {
      const own = problems.filter(p => p.key === name)
      note(bad, own.map(p => `${p.value}: ${p.limit}`).join('; '))
      control.ariaInvalid = own.length ? 'true' : null
    }
    return problems.filter(p => !inputs.has(p.key))
  }
  return {
    node,
    show,
    setSchema(next) {
      schema = next
      shape = ''
      show(text)
    },
  }
}
