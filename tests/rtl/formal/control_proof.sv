// SPDX-License-Identifier: MIT
// Of port, registers and sequencer together, whatever the host asks for and the pipeline does:
//
// - while a step runs, the host writes nothing, and reads nothing that the pipeline uses;
// - no step ends between the fetch of a control word and the write that it is for;
// - unless the status warns of it, the first word of results was read after the last doorbell;
// - a write to RESET, at any time, is done, and then the status tells of a reset alone.
module control_proof
  import pearl_pkg::*;
#(
    parameter int unsigned DATA_WL = 32
) (
    input logic               clk_i,
    input logic               req_i,
    input logic               we_i,
    input logic               fetch_i,
    input logic [        7:0] addr_i,
    input logic [DATA_WL-1:0] wdata_i,
    // What the pipeline says.
    input logic               keys_valid_i,
    input logic               results_done_i
);

  localparam int unsigned W = stream_words(CONTROL_WORDS, 32, DATA_WL);
  localparam int unsigned INDEX_BITS = index_bits(W);
  localparam logic [NumRegions-1:0] SHARED = NumRegions'(
      1 << Observations | 1 << Rewards | 1 << Ters | 1 << Status | 1 << Control | 1 << Doorbell);
  localparam int unsigned ACCESS = 3;
  localparam int unsigned DRAIN_CYCLES = 3;

  // A reset of one cycle, and then as the backbone drains.
  logic started_q = 1'b0;
  logic awake_q = 1'b0;
  logic soft_reset;
  logic [1:0] drain_q;
  always_ff @(posedge clk_i) begin
    started_q <= 1'b1;
    if (!started_q || soft_reset) begin
      awake_q <= 1'b0;
      drain_q <= 2'(DRAIN_CYCLES);
    end else begin
      awake_q <= drain_q == '0;
      if (drain_q != '0) drain_q <= drain_q - 1'b1;
    end
  end

  logic busy, ring, start, done, busy_write, busy_doorbell, untorn;
  logic [NumRegions-1:0] re, we;
  logic [NumRegions-1:0][DATA_WL-1:0] rdata;
  logic [7:0] index;
  logic [DATA_WL-1:0] wdata, next_wdata;
  logic [31:0] cycles;

  pearl_port #(
      .DATA_WL(DATA_WL),
      .WORD_ADDR_BITS(8),
      .OFFSETS(
      '{0, W, 2 * W, 3 * W, 4 * W, 5 * W, 6 * W, 7 * W, 8 * W, 9 * W, 10 * W, 11 * W, 11 * W, 11 * W}
      )
  ) u_port (
      .clk_i,
      .rst_ni         (started_q),
      .req_i,
      .we_i,
      .fetch_i,
      .addr_i,
      .wdata_i,
      .rvalid_o       (),
      .rdata_o        (),
      .resp_o         (),
      .busy_i         (busy || !awake_q),
      .re_o           (re),
      .we_o           (we),
      .index_o        (index),
      .wdata_o        (wdata),
      .next_wdata_o   (next_wdata),
      .rdata_i        (rdata),
      .busy_write_o   (busy_write),
      .busy_doorbell_o(busy_doorbell),
      .untorn_o       (untorn),
      .soft_reset_o   (soft_reset)
  );

  pearl_registers #(
      .DATA_WL(DATA_WL)
  ) u_registers (
      .clk_i,
      .rst_ni         (started_q),
      .draining_i     (!awake_q),
      .index_i        (index[INDEX_BITS-1:0]),
      .control_we_i   (we[Control]),
      .doorbell_we_i  (we[Doorbell]),
      .wdata_i        (wdata),
      .next_wdata_i   (next_wdata),
      .control_o      (),
      .doorbell_o     (),
      .status_o       (),
      .ring_o         (ring),
      .mode_o         (),
      .seed_o         (),
      .tick_o         (),
      .keys_stale_o   (),
      .keys_next_o    (),
      .first_slot_o   (),
      .limited_o      (),
      .limit_o        (),
      .steps_o        (),
      .done_i         (done),
      .last_i         (1'b1),
      .cycles_i       (cycles),
      .busy_write_i   (busy_write),
      .busy_doorbell_i(busy_doorbell),
      .untorn_i       (untorn)
  );
  assign rdata = '0;

  pearl_sequencer u_sequencer (
      .clk_i,
      .rst_ni  (awake_q),
      .ring_i  (ring),
      .keys_valid_i,
      .results_done_i,
      .busy_o  (busy),
      .start_o (start),
      .done_o  (done),
      .cycles_o(cycles)
  );

  // What the request was whose access this is.
  logic [ACCESS:1] fetches_q, resets_q, firsts_q;
  logic fetches, resets, firsts;
  assign fetches = req_i && fetch_i && !we_i;
  assign resets = req_i && we_i && 32'(addr_i) == word_index(
      CONTROL_RESET, DATA_WL
  ) && wdata_i[CONTROL_RESET*32%DATA_WL+:32] != '0;
  assign firsts = req_i && !we_i && !fetch_i && 32'(addr_i) == Observations * W;
  always_ff @(posedge clk_i) begin
    if (!started_q) begin
      fetches_q <= '0;
      resets_q  <= '0;
      firsts_q  <= '0;
    end else begin
      fetches_q <= {fetches_q[ACCESS-1:1], fetches};
      resets_q  <= {resets_q[ACCESS-1:1], resets};
      firsts_q  <= {firsts_q[ACCESS-1:1], firsts};
    end
  end

  // The last access was a fetch of control; a step has ended since.
  logic fetched_q, ended_q;
  // The first word of results has been read since the last doorbell, outside of a step.
  logic seen_q;
  always_ff @(posedge clk_i) begin
    if (!started_q) begin
      fetched_q <= 1'b0;
      ended_q   <= 1'b0;
      seen_q    <= 1'b1;
    end else begin
      if (u_port.valid_q[ACCESS]) fetched_q <= fetches_q[ACCESS] && re[Control];
      ended_q <= !fetches_q[ACCESS] && (ended_q || done);
      if (!awake_q) seen_q <= 1'b1;
      else if (ring) seen_q <= 1'b0;
      else if (firsts_q[ACCESS] && re[Observations] && !busy) seen_q <= 1'b1;
    end
  end

  always_ff @(posedge clk_i) begin
    if (started_q) begin
      if (busy && awake_q) begin
        written : assert (we == '0);
        used : assert ((re & ~SHARED) == '0);
      end
      if (fetched_q && awake_q && we[Control]) spanned : assert (!ended_q && !done);
      if (awake_q) torn : assert (u_registers.error_q.torn_read || seen_q);
      if (resets_q[ACCESS])
        reset :
        assert (soft_reset);
        else calm : assert (!soft_reset);
      if (!awake_q && drain_q == '0) begin
        told : assert (u_registers.error_q == error_t'(4'b1000));
        none : assert (u_registers.finished_q == '0 && u_registers.sequence_q == '0 && !busy);
      end
`ifndef PROPERTY_ONLY
      if (fetched_q && !u_port.valid_q[ACCESS]) begin
        assert (u_port.outdated_q || (!busy && !ended_q));
      end
      if (!awake_q && 32'(drain_q) < DRAIN_CYCLES) assert (!busy);
`endif
    end
  end

endmodule
