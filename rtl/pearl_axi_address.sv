// SPDX-License-Identifier: MIT
// An address channel, AR or AW: takes bursts and gives the addresses of their beats, for AXI4's FIXED, INCR and
// WRAP. A beat a cycle, also from one burst to the next, however short they are.
//
// A burst passes a register slice, and then a stage that works out what its kind, size and length say of its
// addresses, so that there is no more than an adder and a mask from one beat to the next. Its first beat is
// there three cycles after the burst was taken, or right after the last beat of the burst before it.
module pearl_axi_address #(
    parameter int unsigned ADDR_BITS = 16,
    parameter int unsigned ID_BITS   = 4
) (
    input  logic                 clk_i,
    input  logic                 rst_ni,
    input  logic                 valid_i,
    output logic                 ready_o,
    input  logic [  ID_BITS-1:0] id_i,
    input  logic [ADDR_BITS-1:0] addr_i,
    input  logic [          7:0] len_i,
    input  logic [          2:0] size_i,
    input  logic [          1:0] burst_i,
    // A beat, and whether the burst's length says that it is the last one.
    output logic                 valid_o,
    output logic [  ID_BITS-1:0] id_o,
    output logic [ADDR_BITS-1:0] addr_o,
    output logic                 last_o,
    // The beat is done, and whether the burst is done with it.
    input  logic                 next_i,
    input  logic                 end_i
);

  localparam logic [1:0] BURST_FIXED = 2'b00;
  localparam logic [1:0] BURST_WRAP = 2'b10;
  // A beat is of 128 bytes at most, a burst of 256 beats.
  localparam int unsigned BEAT_BITS = 7;
  localparam int unsigned SPAN_BITS = 15;

  // ---- Bursts, as the master gives them ----

  typedef struct packed {
    logic [ID_BITS-1:0] id;
    logic [ADDR_BITS-1:0] addr;
    logic [7:0] len;
    logic [2:0] size;
    logic [1:0] burst;
  } burst_t;

  burst_t taken;
  logic taken_valid, taken_ready;

  pearl_slice #(
      .WIDTH($bits(burst_t))
  ) u_slice (
      .clk_i,
      .rst_ni,
      .valid_i,
      .ready_o,
      .data_i ({id_i, addr_i, len_i, size_i, burst_i}),
      .valid_o(taken_valid),
      .ready_i(taken_ready),
      .data_o (taken)
  );

  // ---- What there is to know of their beats ----

  typedef struct packed {
    logic [ID_BITS-1:0] id;
    logic [ADDR_BITS-1:0] addr;
    // Beats after this one.
    logic [7:0] left;
    // Bits of an address that are within a beat, and those that no beat changes.
    logic [ADDR_BITS-1:0] beat_mask;
    logic [ADDR_BITS-1:0] kept;
  } beats_t;

  beats_t known, waiting_q, beats_q;
  logic waiting_valid_q, valid_q, last_q, load;
  logic [ADDR_BITS-1:0] incremented;

  logic [BEAT_BITS-1:0] within_beat;
  logic [SPAN_BITS-1:0] within_span;
  // A small map has fewer address bits than the longest burst, which then wraps over all of it.
  logic unused_span;
  assign unused_span = ^{within_beat, within_span};

  // A wrapping burst has 2, 4, 8 or 16 beats, so that its length, less one, is a mask.
  assign within_beat = ~(BEAT_BITS'('1) << taken.size);
  assign within_span = SPAN_BITS'(taken.len) << taken.size | SPAN_BITS'(within_beat);

  always_comb begin
    known = '{
        id: taken.id,
        addr: taken.addr,
        left: taken.len,
        beat_mask: ADDR_BITS'(within_beat),
        kept: '0
    };
    unique case (taken.burst)
      BURST_FIXED: known.kept = '1;
      BURST_WRAP: known.kept = ~ADDR_BITS'(within_span);
      default: ;
    endcase
  end

  assign load = !valid_q || (next_i && end_i);
  assign taken_ready = !waiting_valid_q || load;
  // Only the first beat of a burst can be unaligned.
  assign incremented = (beats_q.addr | beats_q.beat_mask) + 1'b1;

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      waiting_valid_q <= 1'b0;
      valid_q         <= 1'b0;
    end else begin
      if (taken_ready) waiting_valid_q <= taken_valid;
      if (load) valid_q <= waiting_valid_q;
    end
  end

  always_ff @(posedge clk_i) begin
    if (taken_ready) waiting_q <= known;
    if (load) begin
      beats_q <= waiting_q;
      last_q  <= waiting_q.left == '0;
    end else if (next_i) begin
      beats_q.addr <= (beats_q.addr & beats_q.kept) | (incremented & ~beats_q.kept);
      beats_q.left <= beats_q.left - 1'b1;
      last_q       <= beats_q.left == 8'd1;
    end
  end

  assign valid_o = valid_q;
  assign id_o    = beats_q.id;
  assign addr_o  = beats_q.addr;
  assign last_o  = last_q;

  always_ff @(posedge clk_i) begin
    if (rst_ni) begin
      assert (valid_q || !next_i)
      else $error("pearl_axi_address: a beat was done that was not there");
    end
  end

endmodule
