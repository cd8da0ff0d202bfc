// Drawing on a canvas, for all pictures: lines, discs, and pixels as sharp as the screen. Knows no data.

/** Sets the size of a canvas in pixels of the page, sharp on this screen; returns its pen, which draws in these pixels. */
export function sharp(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1, pen = canvas.getContext('2d')
  Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) })
  pen.setTransform(ratio, 0, 0, ratio, 0, 0)
  return pen
}

/** Draws a line through points [x, y]. */
export function line(pen, ...points) {
  pen.beginPath()
  for (const [x, y] of points) pen.lineTo(x, y)
  pen.stroke()
}

/** Draws a disc with the colour `fill`, and its rim with the colour `stroke`; both may be absent. */
export function disc(pen, x, y, radius, { fill, stroke, width = 1.5 }) {
  pen.beginPath()
  pen.arc(x, y, radius, 0, 7)
  if (fill) { pen.fillStyle = fill; pen.fill() }
  if (stroke) { pen.strokeStyle = stroke; pen.lineWidth = width; pen.stroke() }
}

/** Writes a text over what is drawn, with a rim, so that it is read on every colour. Font and alignment are those of the pen. */
export function lettering(pen, words, x, y, ink, rim, width = 4) {
  pen.lineWidth = width
  pen.strokeStyle = rim
  pen.strokeText(words, x, y)
  pen.fillStyle = ink
  pen.fillText(words, x, y)
}
