// A placement of weights: what is asked, what is felt, what may be pressed. No requests; one drawing.

import { capital, fixed, plain } from './format.js'
import { disc, lettering, line } from './pen.js'
import { tips } from './skin.js'

const G = 9.81 // m/s²
/** Time after which a skin that was not read at rest no longer forbids "Done", ms. */
const UNREST_MS = 5000

/** 0.75 kg */
export const kilograms = force => fixed(force / G, 2, 'kg')
/** 7.36 N */
export const newtons = force => fixed(force, 2, 'N')
/** Name of the place: as on the overlay, else its position. */
export const spot = c => c.point ?? `${fixed(c.x_mm, 0)}, ${fixed(c.y_mm, 0, 'mm')}`

/** What the skin feels of the weight with a number: { contact, distance_mm }, or null. */
export function feltOf(placement, number) {
  const match = placement.verdict?.matches?.find(match => match.asked === number)
  const contact = match?.felt == null ? null : placement.felt?.contacts?.[match.felt]
  return contact ? { contact, distance_mm: match.distance_mm } : null
}

/** Number of the weight to place now: the first that is not felt, else the one that is farthest off; null if all are right. */
export function present(placement) {
  const { kind } = placement.verdict ?? {}
  if (kind === 'right') return null
  const { contacts } = placement
  if (kind === 'unknown' || !placement.felt) return contacts[0]?.number ?? null
  const missing = contacts.find(({ number }) => !feltOf(placement, number))
  if (missing) return missing.number
  return contacts.reduce((worst, { number }) => feltOf(placement, number).distance_mm > (feltOf(placement, worst)?.distance_mm ?? -1) ? number : worst,
    contacts[0]?.number ?? null)
}

/** Whether the skin was read at rest, or no model reads it at all. */
export const isRead = placement => placement.at_rest === true || placement.verdict?.kind === 'unknown'

/** Why "Done" cannot be pressed now, as words; empty if it can. */
export function notYet(placement, { open, sent, fresh, unrestSince }) {
  if (!fresh) return 'No connection.'
  if (open) return 'Comparing the estimated contacts with what was asked …'
  if (!placement) return 'Nothing is asked.'
  if (placement.stage !== 'place') return ''
  if (sent === placement.trial) return 'Confirmed. Waiting for the service …'
  if (isRead(placement) || Date.now() - unrestSince >= UNREST_MS) return ''
  return placement.at_rest == null ? 'Reading the skin …' : 'Hands off: the signal still moves.'
}

/** One sentence for each stage. */
export const STAGES = { place: 'Place the weights, take your hands off, then press Done.', settling: 'Hands off: waiting until the signal is at rest.',
  measuring: 'Measuring: do not touch the skin.', stored: 'Stored. Lift the weights.' }

/** The verdict as { words, tone }. */
export function verdict(placement) {
  const { kind, words = [] } = placement.verdict ?? {}
  const tone = { right: 'good', wrong: 'bad', unsure: 'warn' }[kind] ?? 'soft'
  if (words.length) return { words: words.map(text => capital(text).replace(/[^.!?]$/, '$&.')).join(' '), tone }
  const plainly = { right: 'Right: every weight is felt where it belongs.', wrong: 'Wrong: the skin feels something else.',
    unsure: 'Unsure: the estimated contacts are not certain enough to judge.',
    unknown: 'Not judged: no model serves. Check each weight yourself.' }[kind]
  return { words: plainly ?? (kind ? plain(kind) : 'Comparing the estimated contacts …'), tone }
}

/** Rest of the signal, as words. */
export const rest = placement => placement.at_rest == null ? 'rest of the signal not known' : placement.at_rest ? 'signal at rest' : 'signal moves'

/** Draws asked places as discs with number and weight, felt ones as rings with an arrow to where they should be. */
export function drawPlacement(pen, view, shape, placement, now) {
  const size = Math.max(13, Math.round(view.width / 34)), diameter = shape.tip_diameter_mm
  const tone = view.colour({ right: '--live', wrong: '--bad' }[placement.verdict?.kind] ?? '--warn')
  for (const [x, y] of shape.points_mm) disc(pen, view.x(x), view.y(y), Math.max(1, 1.7 * view.scale), { fill: view.colour('--grey') })
  if (now) cross(pen, view, shape, now)
  for (const contact of placement.contacts) {
    const { number, x_mm, y_mm } = contact, chosen = number === now?.number
    tips(pen, view, [[x_mm, y_mm]], diameter * (chosen ? 1.5 : 1.2), { fill: view.colour(chosen ? '--live' : '--ink') })
    pen.fillStyle = view.colour('--panel')
    pen.font = `700 ${Math.round(diameter * view.scale * (chosen ? 1 : 0.85))}px system-ui, sans-serif`
    pen.textAlign = 'center'
    pen.textBaseline = 'middle'
    pen.fillText(number, view.x(x_mm), view.y(y_mm) + 1)
  }
  const matched = new Set()
  for (const contact of placement.contacts) {
    const felt = feltOf(placement, contact.number)
    if (!felt) continue
    matched.add(felt.contact)
    const far = felt.distance_mm > diameter, ink = far ? tone : view.colour('--live')
    ring(pen, view, felt.contact, diameter, ink)
    if (far) arrow(pen, view, felt.contact, contact, diameter, ink)
  }
  for (const felt of placement.felt?.contacts ?? []) if (!matched.has(felt)) {
    ring(pen, view, felt, diameter, tone)
    label(pen, view, 'felt, not asked', view.x(felt.x_mm), view.y(felt.y_mm) + size * 1.6, size * 0.8, tone)
  }
  for (const contact of placement.contacts) {
    const high = contact.y_mm > shape.height_mm - 70, left = contact.x_mm > shape.width_mm - 110, right = contact.x_mm < 110
    const x = view.x(contact.x_mm) + (left ? -1 : right ? 1 : 0) * diameter * view.scale
    const y = view.y(contact.y_mm) + (high ? 1 : -1) * (diameter * view.scale * 0.9 + size)
    const ink = view.colour(contact.number === now?.number ? '--live' : '--ink'), side = left ? 'right' : right ? 'left' : 'center'
    label(pen, view, kilograms(contact.force_n), x, y - size * 0.1, size, ink, side)
    label(pen, view, newtons(contact.force_n), x, y + size * 0.85, size * 0.72, ink, side)
  }
}

function cross(pen, view, shape, { x_mm, y_mm }) {
  pen.strokeStyle = view.colour('--live')
  pen.lineWidth = 1
  pen.setLineDash([4, 5])
  line(pen, [view.x(0), view.y(y_mm)], [view.x(shape.width_mm), view.y(y_mm)])
  line(pen, [view.x(x_mm), view.y(0)], [view.x(x_mm), view.y(shape.height_mm)])
  pen.setLineDash([])
}

function ring(pen, view, { x_mm, y_mm }, diameter, tone) {
  tips(pen, view, [[x_mm, y_mm]], diameter * 2, { stroke: view.colour('--panel'), width: 7 })
  tips(pen, view, [[x_mm, y_mm]], diameter * 2, { stroke: tone, width: 3.5 })
}

function arrow(pen, view, from, to, diameter, tone) {
  const [ax, ay, bx, by] = [view.x(from.x_mm), view.y(from.y_mm), view.x(to.x_mm), view.y(to.y_mm)]
  const turn = Math.atan2(by - ay, bx - ax), end = diameter * 0.75 * view.scale, start = diameter * view.scale, head = Math.max(9, view.width / 60)
  const [sx, sy, ex, ey] = [ax + start * Math.cos(turn), ay + start * Math.sin(turn), bx - end * Math.cos(turn), by - end * Math.sin(turn)]
  if (Math.hypot(bx - ax, by - ay) <= start + end + head) return
  pen.strokeStyle = pen.fillStyle = tone
  pen.lineWidth = 3.5
  line(pen, [sx, sy], [ex - head * Math.cos(turn), ey - head * Math.sin(turn)])
  pen.beginPath()
  pen.moveTo(ex, ey)
  for (const side of [2.7, -2.7]) pen.lineTo(ex + 1.2 * head * Math.cos(turn + side), ey + 1.2 * head * Math.sin(turn + side))
  pen.fill()
}

function label(pen, view, words, x, y, size, ink, side = 'center') {
  pen.font = `700 ${Math.round(size)}px system-ui, sans-serif`
  pen.textAlign = side
  pen.textBaseline = 'middle'
  lettering(pen, words, x, y, ink, view.colour('--skin'), 5)
}
