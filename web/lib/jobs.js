// Trainings and evaluations as jobs: the list, and one with its progress, losses and result. Polled each 2 s while one runs.

import { get, send } from './api.js'
import { actor, confirm } from './actions.js'
import { changing } from './changing.js'
import { el, every, fill, link, panel, renew, say, seen, sleep } from './dom.js'
import { capital, count, counted, fixed, listed, moment, percent, plain, span, steadyCountOf } from './format.js'
import { listing } from './listing.js'
import { live } from './live.js'
import { losses } from './losses.js'
import { opened } from './opened.js'
import { reportView } from './scores.js'
import { table } from './table.js'
import { raw } from './toml.js'
import { TONE, isUnderWay } from './words.js'

const recipeName = job => (raw(job.request.recipe ?? '', '', 'name') ?? '').replace(/"/g, '') || 'a recipe'

/** What a job is, in a few words. */
const jobWords = job =>
  job.kind === 'training'
    ? `training of ${recipeName(job)}`
    : `evaluation of ${job.request.scored} on ${job.request.dataset}${job.request.part ? `, ${job.request.part}` : ''}`

function stateWords(job) {
  const p = job.progress
  if (job.state === 'failed') return `failed: ${job.error}`
  if (job.state !== 'running' || !p) return plain(job.state)
  return listed([
    p.phase,
    p.epoch != null && `epoch ${count(p.epoch)}`,
    p.total > 0 && percent(p.done, p.total),
    p.left_s != null && `${span(p.left_s)} to go in this phase`,
  ])
}
const took = job => (job.started_at ? ((job.finished_at ? new Date(job.finished_at) : Date.now()) - new Date(job.started_at)) / 1e3 : null)
const state = job => el('span', { className: TONE[job.state] ?? '' }, stateWords(job))

function resultCell({ result }) {
  if (result?.model) return link(`/nets?model=${result.model}`, result.name)
  return result?.scored ? counted(result.rows, 'row') : null
}

/** Makes the list. `onchange(jobs, ended)` after each reading; `ended`: whether one ended since the last. */
export function jobsPanel({ signal, href, current, onchange }) {
  const rows = table({
    href: job => href(job.id),
    current: job => job.id === current(),
    empty: () => `No training and no evaluation yet${live.may('operator') ? ': start one below' : ''}.`,
    columns: [
      { head: 'Job', left: true, cell: job => capital(jobWords(job)) },
      { head: 'State', left: true, cell: state },
      { head: 'Requested', left: true, cell: job => `${moment(job.created_at, true)} by ${job.asked_by}` },
      { head: 'Took', cell: job => span(took(job)) },
      { head: 'Result', left: true, cell: resultCell },
    ],
  })
  const known = listing('/jobs', { words: 'The jobs', draw, limit: 25, most: 500, signal }),
    node = panel('Jobs', { className: 'live' }, known.trouble, rows.node, el('div', { className: 'row' }, known.more))
  let before = ''
  function draw(page) {
    if (!page) return
    const jobs = known.items
    rows.show(jobs)
    const ended = jobs.filter(job => !isUnderWay(job)).map(job => job.id).join(),
      changed = before !== '' && before !== ended
    before = ended || '-'
    onchange(jobs, changed)
  }
  every(() => (known.items.some(isUnderWay) ? 2000 : 10_000), () => known.read(), signal)
  return { node, read: () => known.read(), redraw: () => rows.show(known.items), all: () => known.items }
}

/** What a job has made, or the recipe of a training that has made nothing yet. */
function resultPart({ kind, result, request }, models) {
  if (result?.scored) return panel('Result', {}, reportView(result, models))
  if (result?.model) {
    const model = link(`/nets?model=${result.model}`, `${result.name} (${result.model})`)
    return panel('Result', {}, el('p', {}, 'The model ', model, ' is stored. Evaluate it, then promote it.'))
  }
  return kind === 'training' && panel('Recipe', {}, el('pre', { tabIndex: 0 }, request.recipe.trim()))
}

/** Makes the view of one job; ends what it began when another one is shown. */
export function jobView({ signal, said, models, onstopped }) {
  return opened({ className: 'job', signal, draw: follow, back: ['/nets', 'All nets'] })

  async function follow(node, id, mine) {
    const title = el('span', {}),
      words = el('p', {}),
      stated = el('span', {}),
      from = el('span', {}),
      bar = el('progress', { max: 1, value: 0, 'aria-label': 'Progress of this phase' }),
      numbers = el('div'),
      result = el('div'),
      controls = el('div', { className: 'row' })
    fill(node,
      el('section', { className: 'live', 'aria-label': 'Job' },
        el('div', { className: 'row spread' }, el('h2', { className: 'big' }, title), link('/nets', 'Close')),
        words,
        bar,
        numbers,
        controls
      ),
      result
    )
    let job = null,
      curves = null
    const stop = actor('Stop the job', said, () => send(`/jobs/${id}/stop`, undefined, { method: 'POST' }).finally(onstopped), {
      locks: false,
      className: 'danger',
      sure: () => confirm('Stop this job?', 'A stopped training keeps no model. It can be requested again.', 'Stop the job'),
    })
    const draw = () => {
      say(title, capital(jobWords(job)))
      // Only what differs is set: a focus on the link or the button stays.
      say(stated, stateWords(job)).className = TONE[job.state] ?? ''
      renew(from, [job.state, job.dataset], () => [
        job.state === 'waiting' ? '. Jobs run one after the other; this one begins by itself.' : '.',
        job.dataset && [' Dataset: ', link(`/data?dataset=${job.dataset}`, job.dataset), '.'],
      ])
      if (!words.contains(stated)) fill(words, stated, from)
      bar.hidden = job.state !== 'running'
      bar.value = job.progress?.total ? job.progress.done / job.progress.total : 0
      const p = job.progress
      changing(numbers, [
        ['Requested', moment(job.created_at, true)],
        ['By', job.asked_by],
        ['Took', span(took(job))],
        p?.total > 0 && ['Done', steadyCountOf(p.done, p.total)],
        p?.per_second != null && ['Rate', `${count(Math.round(p.per_second))} per s`],
        p?.train_loss != null && ['Train loss', fixed(p.train_loss, 5)],
        p?.validation_loss != null && ['Validation loss', fixed(p.validation_loss, 5)],
      ])
      if (controls.hasChildNodes() !== isUnderWay(job)) fill(controls, isUnderWay(job) && stop)
      if (job.kind === 'training' && job.state !== 'waiting' && !curves) {
        curves = losses({ path: `/jobs/${id}/losses`, key: 'job-losses', signal: mine, live: () => job.state === 'running' })
        node.append(el('section', { className: 'live' }, curves.node))
      }
      renew(result, job.state, () => resultPart(job, models()))
    }
    while (!mine.aborted) {
      try {
        job = await get(`/jobs/${id}`, {}, { signal: mine })
        if (mine.aborted) return
        draw()
        if (!isUnderWay(job)) return
      } catch (error) {
        if (mine.aborted) return
        if (!job) {
          say(title, id)
          fill(words, el('span', { className: 'bad' }, error.message))
          if (error.status) return
        }
      }
      await sleep(2000, mine)
      await seen(mine)
    }
  }
}
