// The two forms of the nets: start a training, start an evaluation. What is sent can be read before.

import { get, keep, once, readOnce } from './api.js'
import { actor } from './actions.js'
import { choose, el, field, panel, say, select } from './dom.js'
import { fold } from './fold.js'
import { capital } from './format.js'
import { keepForm } from './formstate.js'
import { slotOf, slotOfTask } from './serves.js'
import { put, raw } from './toml.js'
import { vocabulary } from './vocabulary.js'

/** Fills a select. What a person or the address has chosen stays, whatever is read later. */
function choices(node, list, without) {
  const { chosen } = node.dataset
  const wanted = chosen ?? node.value
  const all = [...list, ...(without ? [['', without]] : [])].map(one => (Array.isArray(one) ? one : [one, one]))
  if (chosen && !all.some(([of]) => of === chosen)) all.push([chosen, chosen])
  node.replaceChildren(...all.map(([of, words]) => el('option', { value: of }, words)))
  const isThere = all.some(([of]) => of === wanted) && (wanted || chosen != null)
  node.value = isThere ? wanted : (all[0]?.[0] ?? '')
}

/** Makes the button of a form: it sends `body()` once to `path`; `onstart` gets the job. */
const starter = (words, what, path, body, { said, onstart }) => actor(words, said, async () => onstart(await once(path, body())), { className: 'main', what })

/** Recipes that the program carries, with their texts, and the keys that follow from each force map. */
const recipes = readOnce(() => get('/recipes').then(page => page.items))

const USUAL_RECIPE = 'transfer-net'
const DRAFT = 'palpate-draft-training'

/**
 * Form of a training. `knows({ datasets, models })` fills its choices. Its fields are in the address; what is written into
 * its text beyond them is kept in this tab, since a text is too long for an address.
 */
export function trainingForm({ said, onstart, signal }) {
  const about = el('p', { className: 'soft' }),
    text = el('textarea', { id: 'tr-text', rows: 14, spellcheck: false })
  const recipe = select([USUAL_RECIPE], USUAL_RECIPE, () => {
      begin()
      written()
    }),
    dataset = select([], '', change),
    map = select([], '', change)
  let carried = []
  const chosen = () => carried.find(one => one.name === recipe.value)
  const number = props => el('input', { type: 'number', min: 1, step: 1, onchange: change, ...props })
  const epochs = number({}),
    rows = number({ placeholder: 'all' }),
    seed = number({ min: 0 }),
    name = el('input', { maxLength: 100, onchange: change })
  // Words, control and key; and the table in which the text has the key, which has no recipe.
  const CONTROLS = [
    ['Recipe', recipe, 'recipe'],
    ['Dataset', dataset, 'dataset', ''],
    ['Epochs', epochs, 'epochs', 'training'],
    ['Rows of an epoch', rows, 'rows', ''],
    ['Seed', seed, 'seed', 'training'],
    ['Force map, pixel x diameter, mm', map, 'map', ''],
    ['Name of the model', name, 'name', ''],
  ]
  const fields = CONTROLS.map(([words, node, key]) => field(words, node, `tr-${key}`))
  const all = CONTROLS.map(([, node]) => node)
  const placeOf = new Map(CONTROLS.map(([, node, key, table]) => [node, [table, key]]))
  const plainOf = (of, node) => (raw(of, ...placeOf.get(node)) ?? '').replace(/^"|"$/g, '')
  /** The fields as the text has them. */
  function show() {
    const [wanted, wantedMap] = [plainOf(text.value, dataset), plainOf(text.value, map)]
    if (wanted) choose(dataset, wanted)
    else dataset.value = ''
    if (wantedMap) map.value = wantedMap
    for (const node of [epochs, rows, seed, name]) node.value = plainOf(text.value, node)
  }
  function begin() {
    if (!chosen()) recipe.value = USUAL_RECIPE // That of an old address.
    for (const node of [dataset, map]) delete node.dataset.chosen
    const { text: begun, about: words, maps } = chosen()
    text.value = begun
    say(about, words)
    choices(map, maps.map(one => one.map))
    map.parentNode.hidden = !maps.length
    show()
  }
  /** The text as the fields have it. */
  function change() {
    let now = text.value
    const write = (table, key, value) => {
      now = put(now, table, key, value)
    }
    write('', 'dataset', dataset.value ? JSON.stringify(dataset.value) : null)
    write('', 'name', JSON.stringify(name.value.trim() || recipe.value))
    write('', 'rows', rows.value || null)
    if (epochs.value) write('training', 'epochs', epochs.value)
    if (seed.value) write('training', 'seed', seed.value)
    const drawn = chosen()?.maps.find(one => one.map === map.value)
    if (drawn) {
      write('', 'map', JSON.stringify(drawn.map))
      write('training.net', 'side', String(drawn.side))
      write('training.net', 'channels', drawn.channels && JSON.stringify(drawn.channels))
    }
    text.value = now
    remember()
  }
  const values = () => JSON.stringify(all.map(node => node.value))
  let held = '' // The fields as the address has them. While the text is typed, the fields do not follow yet.
  const keepText = () => keep('sessionStorage', DRAFT, JSON.stringify({ text: text.value, values: held }))
  function remember() {
    held = values()
    keepText()
  }
  let write = () => {}
  /** The address as the fields are, after the form has set some. */
  function written() {
    for (const node of all) write(node)
    remember()
  }
  text.addEventListener('input', () => held && keepText())
  text.addEventListener('change', () => {
    show()
    written()
  })
  const start = starter('Train', 'Request the training', '/trainings', () => ({ recipe: text.value }), { said, onstart })
  const node = panel('Start a training', {},
    el('p', { className: 'soft' }, 'It trains in the service at low priority, one job after the other, and continues after a restart.'),
    el('div', { className: 'form' }, fields),
    about,
    fold('recipe', 'The recipe as it is sent', { signal }, el('label', { htmlFor: 'tr-text' }, 'Recipe (TOML)'), text),
    el('div', { className: 'row' }, start)
  )
  recipes().then(found => {
    if (signal.aborted) return undefined
    carried = found
    choices(recipe, carried.map(one => one.name))
    begin()
    const kept = keep('sessionStorage', DRAFT)
    const usual = node => (node === recipe ? USUAL_RECIPE : plainOf(chosen().text, node) || (node === map ? (chosen().maps[0]?.map ?? '') : ''))
    write = keepForm(all, { usual, changed: node => (node === recipe ? begin() : change()), signal })
    // What was written into the text belongs to the fields that it had.
    const draft = kept && JSON.parse(kept)
    if (draft?.values !== values()) return remember()
    text.value = draft.text
    show()
    return written()
  }, error => say(about, `The list of recipes could not be read: ${error.message}.`))
  return {
    node,
    knows({ datasets }) {
      choices(dataset, datasets, 'none')
      show()
    },
  }
}

/** Form of an evaluation. `knows({ datasets, models })` fills its choices. Its values are in the address. */
export function evaluationForm({ said, onstart, signal }) {
  const about = el('p', { className: 'soft' })
  const methodOf = name => vocabulary.scored.find(one => one.name === name)
  const usualMethod = vocabulary.scored[0].name
  const scored = select(vocabulary.scored.map(one => one.name), usualMethod, () => {
      delete dataset.dataset.chosen // Each method has the dataset that the paper scores it on.
      show()
      write(dataset)
    }),
    dataset = select([], '', () => {}),
    part = select([['', 'all rows'], 'train', 'validation', 'test'], 'test', () => {}),
    frames = select([['mean', 'mean of all'], ['first', 'first only']], 'mean', () => {})
  // The keys of a request that name nets; a skin that is not named is the serving one.
  const isOfNets = one => one.slots.every(slot => slotOf(slot).tasks.length)
  const keysOf = method => method.models.filter(isOfNets)
  const slotsOf = new Map(vocabulary.scored.flatMap(keysOf).map(one => [one.key, one.slots]))
  const titleOf = (key, slots) => capital(slots.length === 1 ? slotOf(slots[0]).title : key)
  const models = Object.fromEntries([...slotsOf.keys()].map(key => [key, select([], '', () => {})]))
  const number = props => el('input', { type: 'number', min: 1, ...props })
  const limit = number({ step: 1, placeholder: 'all' }),
    sd = number({ step: 'any', placeholder: 'any' })
  const fields = {
    scored: field('What is scored', scored, 'ev-scored'),
    dataset: field('Dataset', dataset, 'ev-dataset'),
    part: field('Part', part, 'ev-part'),
    ...Object.fromEntries(Object.entries(models).map(([key, node]) => [key, field(titleOf(key, slotsOf.get(key)), node, `ev-${key}`)])),
    limit: field('Rows, taken evenly', limit, 'ev-limit'),
    frames: field('Frames', frames, 'ev-frames'),
    sd: field('Only contacts known to, mm', sd, 'ev-sd'),
  }
  let known = { datasets: [], models: [] }
  function show() {
    if (!methodOf(scored.value)) scored.value = usualMethod
    const method = methodOf(scored.value)
    say(about, `${capital(method.about)}.`)
    for (const [key, node] of Object.entries(models)) {
      const used = keysOf(method).find(one => one.key === key)
      fields[key].hidden = !used
      const fit = known.models.filter(model => slotsOf.get(key).includes(slotOfTask(model.task)?.name)).map(model => [model.id, `${model.name} · ${model.id}`])
      choices(node, fit, used?.required ? (fit.length ? null : 'none is trained yet') : 'none')
    }
    fields.sd.hidden = !method.states_sd
    if (!dataset.dataset.chosen && [...dataset.options].some(option => option.value === method.dataset)) dataset.value = method.dataset
  }
  function body() {
    const method = methodOf(scored.value)
    const named = Object.fromEntries(keysOf(method).map(({ key }) => [key, models[key].value]).filter(([, value]) => value))
    return {
      scored: scored.value,
      dataset: dataset.value,
      frames: frames.value,
      ...named,
      ...(part.value && { part: part.value }),
      ...(limit.value && { limit: Number(limit.value) }),
      ...(method.states_sd && sd.value && { place_sd_mm: Number(sd.value) }),
    }
  }
  const start = starter('Evaluate', 'Request the evaluation', '/evaluations', body, { said, onstart })
  const node = panel('Start an evaluation', {},
    el('p', { className: 'soft' }, 'Scores on rows that the nets did not see: choose the part test, or a dataset of another run.'),
    el('div', { className: 'form' }, Object.values(fields)),
    about,
    el('div', { className: 'row' }, start)
  )
  // A dataset and nets that no person has chosen follow the method and what is trained.
  const follows = new Set([dataset, ...Object.values(models)])
  const usual = control => (!follows.has(control) ? undefined : control.dataset.chosen ? false : control.value)
  const write = keepForm([scored, part, limit, frames, sd, ...follows], { usual, changed: show, signal })
  return {
    node,
    knows(next) {
      known = next
      choices(dataset, next.datasets)
      show()
    },
  }
}
