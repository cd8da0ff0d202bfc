// What a dataset was made from, as a graph to walk: dataset, runs, trials, frame. A choice is in the address.

import { get, withQuery } from './api.js'
import { button, el, fill, link, onLook, soon } from './dom.js'
import { NONE, count, counted, fixed, listed, moment } from './format.js'
import { frame } from './frame.js'

const PAGE = 8,
  COLUMNS = 'trial_id,configuration,depth_mm,contact_count,max_force_n'
const force = row => fixed(row.max_force_n, 1, 'N')
const SVG = 'http://www.w3.org/2000/svg'

/** Makes the graph of `{ lineage, dataset }`; `chosen` is { run, trial } of the address, `set` changes it. */
export function lineageWalk({ dataset, lineage, nets, signal, set }) {
  let chosen = {},
    shownRun = null,
    shownTrial = null,
    next = null,
    rows = []
  const boxes = new Map(),
    lines = document.createElementNS(SVG, 'svg')
  lines.setAttribute('aria-hidden', 'true')
  lines.classList.add('walk-lines')
  const box = (key, title, inside, { href, pick, of = 'dataset' } = {}) => {
    const node = el(pick ? 'button' : 'div', { className: 'walk-box', ...(pick && { type: 'button', onclick: pick }) },
      el('b', {}, href ? el('a', { href }, title) : title),
      inside.filter(Boolean).map(words => el('span', { className: 'soft small' }, words))
    )
    boxes.set(key, { node, of })
    return node
  }
  const column = (title, ...inside) => el('li', {}, el('h3', {}, title), inside)
  const root = box('dataset', dataset.name, [dataset.id, `${counted(dataset.rows, 'row')}, made ${moment(dataset.created_at)}`], { of: null })
  const runs = lineage.runs.map(run => {
    const used = `${counted(run.trials ?? 0, 'trial')} of it${run.taken_back ? `, ${count(run.taken_back)} taken back` : ''}`
    const pick = () => set({ run: String(run.scan_id) === chosen.run ? null : run.scan_id, trial: null })
    return box(`run-${run.scan_id}`, `Run ${run.scan_id} · ${run.experiment}`, [`${run.kind}, ${run.label}, seed ${run.seed ?? NONE}`, used], { pick })
  })
  const models = lineage.models.map(({ model, calibration }) =>
    box(model, 'Twins by a model', [model, calibration ? `calibration ${calibration}` : 'values of the sensor file, not calibrated'])
  )
  const shards = lineage.sim_random.map(({ folder, shards, definition }) => {
    const made = `seed ${definition?.draws?.seed ?? NONE}, ${definition?.model ?? 'model unknown'}`
    return box(folder, `Sim-Random ${folder}`, [counted(shards?.length ?? 0, 'shard'), made])
  })
  const { version, git_commit } = lineage.code
  const code = box('code', 'Program', [`Palpate ${version}`, git_commit ? `commit ${git_commit.slice(0, 12)}` : 'commit unknown'])
  const learned = nets.map(net => box(net.id, net.name, [net.id, net.task], { href: `/nets?model=${net.id}` }))
  const trials = el('div', { className: 'walk-list' }),
    more = button('More', () => readTrials(), { hidden: true, className: 'plain' }),
    toTrials = el('p', { className: 'small' })
  const label = () => lineage.runs.find(run => String(run.scan_id) === chosen.run)?.label ?? ''
  const picture = frame({ title: 'Measured frame', signal, label })
  const words = el('div', { className: 'small' })
  const end = el('div', { hidden: true }, picture.node, words)
  const hint = {
    run: el('p', { className: 'soft' }, runs.length ? 'Choose a run.' : 'No run: simulated rows only.'),
    trial: el('p', { className: 'soft' }, 'Choose a trial.'),
  }
  const trained = learned.length ? [el('h3', {}, 'Trained on it'), learned] : el('p', { className: 'soft small' }, 'No net was trained on it.')
  const node = el('div', { className: 'walk' },
    lines,
    el('ol', { className: 'walk-columns' },
      column('Dataset', root, trained),
      column('Made from', runs, models, shards, code),
      column('Trials', hint.run, trials, more, toTrials),
      column('Frame', hint.trial, end)
    )
  )

  const draw = soon(() => {
    const from = node.getBoundingClientRect()
    if (!from.width) return
    lines.setAttribute('viewBox', `0 0 ${from.width} ${from.height}`)
    const path = ({ node: to, of }) => {
      const start = boxes.get(of)?.node
      if (!start?.isConnected || !to.isConnected) return null
      const [a, b] = [start.getBoundingClientRect(), to.getBoundingClientRect()]
      if (b.left < a.right) return null // Below each other on a phone: the order says it.
      const [x1, y1, x2, y2] = [a.right - from.left, a.top + a.height / 2 - from.top, b.left - from.left, b.top + Math.min(24, b.height / 2) - from.top],
        mid = (x1 + x2) / 2
      const one = document.createElementNS(SVG, 'path')
      one.setAttribute('d', `M${x1},${y1} C${mid},${y1} ${mid},${y2} ${x2},${y2}`)
      one.classList.toggle('chosen', to.getAttribute('aria-pressed') === 'true' || to === end)
      return one
    }
    lines.replaceChildren(...[...boxes.values()].filter(one => one.of).map(path).filter(Boolean))
  })
  onLook(node, draw, signal)

  const rowsOf = query => get(`/datasets/${dataset.id}/rows`, { columns: COLUMNS, ...query }, { signal }).catch(() => null)
  async function readTrials() {
    const run = chosen.run
    more.disabled = true
    const page = await rowsOf({ where: `scan_id=${run}`, limit: PAGE, cursor: next })
    more.disabled = false
    if (run !== chosen.run || signal.aborted) return
    if (!page) {
      fill(trials, el('p', { className: 'bad' }, 'The rows could not be read.'))
      return
    }
    rows = [...rows, ...page.items.filter(item => !rows.some(row => row.trial_id === item.trial_id))]
    next = page.next
    if (chosen.trial && !rows.some(row => String(row.trial_id) === chosen.trial)) {
      // A chosen one beyond this page stands first.
      const one = await rowsOf({ where: `trial_id=${chosen.trial}`, limit: 1 })
      if (run !== chosen.run || signal.aborted) return
      if (one?.items.length) rows = [...one.items, ...rows]
    }
    more.hidden = !next || rows.length >= 120
    listTrials()
  }
  function listTrials() {
    for (const key of [...boxes.keys()]) if (String(key).startsWith('trial-')) boxes.delete(key)
    fill(trials,
      rows.map(row => {
        const words = listed([`configuration ${row.configuration}`, fixed(row.depth_mm, 1, 'mm'), counted(row.contact_count, 'contact'), force(row)])
        const pick = () => set({ trial: String(row.trial_id) === chosen.trial ? null : row.trial_id })
        const one = box(`trial-${row.trial_id}`, `Trial ${row.trial_id}`, [words], { of: `run-${chosen.run}`, pick })
        one.setAttribute('aria-pressed', String(String(row.trial_id) === chosen.trial))
        return one
      })
    )
    draw()
  }
  async function showTrial() {
    const id = chosen.trial
    end.hidden = true
    if (!id) {
      draw()
      return
    }
    try {
      const row = await get(`/trials/${id}`, {}, { signal })
      if (id !== chosen.trial) return
      end.hidden = false
      picture.show(row.voltages_v)
      fill(words,
        el('p', {},
          `Run ${row.scan_id}, configuration ${row.configuration}, ${fixed(row.depth_mm, 2, 'mm')}. Mean of ${counted(row.frame_count, 'raw frame')}.`
        ),
        el('p', {}, link(`/trials?trial=${id}`, 'Open this trial'))
      )
      boxes.set('frame', { node: end, of: `trial-${id}` })
    } catch (error) {
      if (signal.aborted || id !== chosen.trial) return
      end.hidden = false
      picture.show(null)
      fill(words, el('p', { className: 'bad' }, `Trial ${id} cannot be shown: ${error.message}.`))
    }
    draw()
  }

  return {
    node,
    show(query) {
      chosen = { run: query.run, trial: query.trial }
      for (const run of lineage.runs) boxes.get(`run-${run.scan_id}`).node.setAttribute('aria-pressed', String(String(run.scan_id) === chosen.run))
      hint.run.hidden = Boolean(chosen.run)
      hint.trial.hidden = Boolean(chosen.trial)
      if (shownRun !== chosen.run) {
        shownRun = chosen.run
        rows = []
        next = null
        more.hidden = true
        fill(trials)
        fill(toTrials, chosen.run && link(withQuery('/trials', { scan_id: chosen.run }), `All trials of run ${chosen.run}`))
        if (chosen.run) readTrials()
      } else listTrials()
      if (shownTrial !== chosen.trial) {
        shownTrial = chosen.trial
        showTrial()
      }
      draw()
    },
  }
}
