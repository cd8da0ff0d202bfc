// The two forms of the nets: start a training, start an evaluation. What is sent can be read before.

import { once } from './api.js'
import { actor } from './actions.js'
import { el, panel, say, select, set } from './dom.js'
import { FEW, RECIPES, hasMap, side } from './recipes.js'
import { put, raw } from './toml.js'

const MAPS = ['4x20', '4x28', '4x32', '4x44', '4x52', '4x60', '10x10', '10x30', '10x50', '10x70', '20x20', '20x60']
const field = (words, node, id) => {
  node.id = id
  return el('div', { data: { field: id } }, el('label', { htmlFor: id }, words), node)
}
const choices = (node, list, without) => {
  const value = node.value
  node.replaceChildren(
    ...[...list, ...(without ? [['', without]] : [])]
      .map(one => (Array.isArray(one) ? one : [one, one]))
      .map(([of, words]) => el('option', { value: of }, words))
  )
  node.value = [...node.options].some(option => option.value === value) && value ? value : (node.options[0]?.value ?? '')
}

/** Form of a training. `knows({ datasets, models })` fills its choices. */
export function trainingForm({ said, onstart }) {
  const about = el('p', { className: 'soft' }),
    text = el('textarea', { id: 'tr-text', rows: 14, spellcheck: false })
  const recipe = select(Object.keys(RECIPES), 'transfer-net', begin),
    dataset = select([], '', change),
    map = select(MAPS, '4x20', change)
  const number = props => el('input', { type: 'number', min: 1, step: 1, onchange: change, ...props })
  const epochs = number({}),
    rows = number({ placeholder: 'all' }),
    seed = number({ min: 0 }),
    name = el('input', { maxLength: 100, onchange: change })
  const fields = [
    field('Recipe', recipe, 'tr-recipe'),
    field('Dataset', dataset, 'tr-dataset'),
    field('Epochs', epochs, 'tr-epochs'),
    field('Rows of an epoch', rows, 'tr-rows'),
    field('Seed', seed, 'tr-seed'),
    field('Force map, pixel x diameter, mm', map, 'tr-map'),
    field('Name of the model', name, 'tr-name'),
  ]
  const plainOf = (table, key) => (raw(text.value, table, key) ?? '').replace(/^"|"$/g, '')
  /** The fields as the text has them. */
  function show() {
    const [wanted, wantedMap] = [plainOf('', 'dataset'), plainOf('', 'map')]
    if (wanted && ![...dataset.options].some(option => option.value === wanted)) dataset.append(el('option', { value: wanted }, wanted))
    set(dataset, { value: wanted })
    if (wantedMap) map.value = wantedMap
    for (const [node, table, key] of [
      [epochs, 'training', 'epochs'],
      [rows, '', 'rows'],
      [seed, 'training', 'seed'],
      [name, '', 'name'],
    ])
      node.value = plainOf(table, key)
  }
  function begin() {
    text.value = RECIPES[recipe.value].text
    say(about, RECIPES[recipe.value].about)
    fields.find(node => node.dataset.field === 'tr-map').hidden = !hasMap(recipe.value)
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
    if (hasMap(recipe.value)) {
      write('', 'map', JSON.stringify(map.value))
      write('training.net', 'side', String(side(map.value)))
      write('training.net', 'channels', side(map.value) <= FEW.pixels ? FEW.channels : null)
    }
    text.value = now
  }
  text.addEventListener('change', show)
  const start = actor(
    'Train',
    said,
    async () => {
      const job = await once('/trainings', { recipe: text.value })
      onstart(job)
      return job
    },
    { className: 'main', what: 'Request the training' }
  )
  const node = panel(
    'Start a training',
    {},
    el('p', { className: 'soft' }, 'It trains in the service at low priority, one job after the other, and continues after a restart.'),
    el('div', { className: 'form' }, fields),
    about,
    el('details', {}, el('summary', {}, 'The recipe as it is sent'), el('label', { htmlFor: 'tr-text' }, 'Recipe (TOML)'), text),
    el('div', { className: 'row' }, start)
  )
  begin()
  return {
    node,
    knows({ datasets }) {
      choices(dataset, datasets, 'none')
      show()
    },
  }
}

// Which models each method reads, as the service requires them.
const METHODS = {
  voltages: { about: 'Voltages of a Transfer-Net, or the measured ones, against the twins: Table III.', uses: ['transfer'], dataset: 'r2s-transfer' },
  paper: {
    about: 'Transfer-Net, Recon-Net, peaks of the force map: the paper\u2019s pipeline (V-C, V-D).',
    uses: ['transfer', 'map'],
    dataset: 'real-unseen',
  },
  fast: { about: 'Point-Net\u2019s candidates.', uses: ['points'], dataset: 'real-unseen' },
  exact: { about: 'Contacts fitted to the frame through the model of the serving skin.', uses: ['points', 'skin'], dataset: 'real-unseen' },
  tikhonov: { about: 'One-step reconstruction with Tikhonov\u2019s regularisation: a baseline of the paper.', uses: ['skin'], dataset: 'real-unseen' },
  noser: { about: 'One-step reconstruction with NOSER\u2019s regularisation: a baseline.', uses: ['skin'], dataset: 'real-unseen' },
}
const NEEDED = { paper: ['map'], fast: ['points'] }
const TASKS = { transfer: ['transfer'], map: ['recon', 'end-to-end'], points: ['points'] }

/** Form of an evaluation. `knows({ datasets, models })` fills its choices. */
export function evaluationForm({ said, onstart }) {
  const about = el('p', { className: 'soft' })
  const scored = select(Object.keys(METHODS), 'voltages', show),
    dataset = select([], '', () => {}),
    part = select([['', 'all rows'], 'train', 'validation', 'test'], 'test', () => {}),
    frames = select(
      [
        ['mean', 'mean of all'],
        ['first', 'first only'],
      ],
      'mean',
      () => {}
    )
  const models = { transfer: select([], '', () => {}), map: select([], '', () => {}), points: select([], '', () => {}) }
  const number = props => el('input', { type: 'number', min: 1, ...props })
  const limit = number({ step: 1, placeholder: 'all' }),
    sd = number({ step: 'any', placeholder: 'any' })
  const fields = {
    scored: field('What is scored', scored, 'ev-scored'),
    dataset: field('Dataset', dataset, 'ev-dataset'),
    part: field('Part', part, 'ev-part'),
    transfer: field('Transfer-Net', models.transfer, 'ev-transfer'),
    map: field('Net with force maps', models.map, 'ev-map'),
    points: field('Point-Net', models.points, 'ev-points'),
    limit: field('Rows, taken evenly', limit, 'ev-limit'),
    frames: field('Frames', frames, 'ev-frames'),
    sd: field('Only contacts known to, mm', sd, 'ev-sd'),
  }
  let known = { datasets: [], models: [] }
  function show() {
    const method = METHODS[scored.value]
    say(about, method.about)
    for (const key of ['transfer', 'map', 'points']) {
      fields[key].hidden = !method.uses.includes(key)
      const fit = known.models.filter(model => TASKS[key].includes(model.task)).map(model => [model.id, `${model.name} · ${model.id}`])
      choices(models[key], fit, NEEDED[scored.value]?.includes(key) ? (fit.length ? null : 'none is trained yet') : 'none')
    }
    fields.sd.hidden = scored.value !== 'exact'
    if ([...dataset.options].some(option => option.value === method.dataset)) dataset.value = method.dataset
  }
  const start = actor(
    'Evaluate',
    said,
    async () => {
      const method = METHODS[scored.value],
        named = Object.fromEntries(
          ['transfer', 'map', 'points'].filter(key => method.uses.includes(key) && models[key].value).map(key => [key, models[key].value])
        )
      const job = await once('/evaluations', {
        scored: scored.value,
        dataset: dataset.value,
        frames: frames.value,
        ...named,
        ...(part.value && { part: part.value }),
        ...(limit.value && { limit: Number(limit.value) }),
        ...(scored.value === 'exact' && sd.value && { place_sd_mm: Number(sd.value) }),
      })
      onstart(job)
      return job
    },
    { className: 'main', what: 'Request the evaluation' }
  )
  const node = panel(
    'Start an evaluation',
    {},
    el('p', { className: 'soft' }, 'Scores on rows that the nets did not see: choose the part test, or a dataset of another run.'),
    el('div', { className: 'form' }, Object.values(fields)),
    about,
    el('div', { className: 'row' }, start)
  )
  return {
    node,
    knows(next) {
      known = next
      choices(dataset, next.datasets)
      show()
    },
  }
}
