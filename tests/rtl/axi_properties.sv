// SPDX-License-Identifier: MIT
// What AXI4 (IHI 0022) demands of a slave that answers bursts in their order, and of its master. What the
// slave owes is asserted. What the master owes is assumed: a proof takes it for granted, a simulation
// checks it as well.
module axi_properties
  import pearl_pkg::*;
#(
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned ADDR_BITS = 16,
    parameter int unsigned ID_BITS = 4,
    // Bursts of either kind that the slave accepts before it ends the first of them: on the address channel, and
    // those of one beat whose answers have places.
    parameter int unsigned OUTSTANDING = 4 + 2 ** $clog2(PORT_LATENCY + 2),
    localparam int unsigned STRB_BITS = DATA_WL / 8
) (
    input logic                 clk_i,
    input logic                 rst_ni,
    input logic [  ID_BITS-1:0] s_axi_awid,
    input logic [ADDR_BITS-1:0] s_axi_awaddr,
    input logic [          7:0] s_axi_awlen,
    input logic [          2:0] s_axi_awsize,
    input logic [          1:0] s_axi_awburst,
    input logic                 s_axi_awvalid,
    input logic                 s_axi_awready,
    input logic [  DATA_WL-1:0] s_axi_wdata,
    input logic [STRB_BITS-1:0] s_axi_wstrb,
    input logic                 s_axi_wlast,
    input logic                 s_axi_wvalid,
    input logic                 s_axi_wready,
    input logic [  ID_BITS-1:0] s_axi_bid,
    input logic [          1:0] s_axi_bresp,
    input logic                 s_axi_bvalid,
    input logic                 s_axi_bready,
    input logic [  ID_BITS-1:0] s_axi_arid,
    input logic [ADDR_BITS-1:0] s_axi_araddr,
    input logic [          7:0] s_axi_arlen,
    input logic [          2:0] s_axi_arsize,
    input logic [          1:0] s_axi_arburst,
    input logic                 s_axi_arvalid,
    input logic                 s_axi_arready,
    input logic [  ID_BITS-1:0] s_axi_rid,
    input logic [  DATA_WL-1:0] s_axi_rdata,
    input logic [          1:0] s_axi_rresp,
    input logic                 s_axi_rlast,
    input logic                 s_axi_rvalid,
    input logic                 s_axi_rready
);

  localparam int unsigned COUNT_BITS = $clog2(OUTSTANDING + 1);

  typedef struct packed {
    logic [ID_BITS-1:0] id;
    logic [ADDR_BITS-1:0] addr;
    logic [7:0] len;
    logic [2:0] size;
    logic [1:0] burst;
  } burst_t;

  typedef struct packed {
    logic last;
    logic [STRB_BITS-1:0] strb;
    logic [DATA_WL-1:0] data;
  } beat_t;

  typedef struct packed {
    logic [ID_BITS-1:0] id;
    logic [1:0] resp;
  } done_t;

  typedef struct packed {
    logic [ID_BITS-1:0] id;
    logic [1:0] resp;
    logic last;
    logic [DATA_WL-1:0] data;
  } answer_t;

  burst_t aw, ar;
  beat_t   w;
  done_t   b;
  answer_t r;
  assign aw = {s_axi_awid, s_axi_awaddr, s_axi_awlen, s_axi_awsize, s_axi_awburst};
  assign ar = {s_axi_arid, s_axi_araddr, s_axi_arlen, s_axi_arsize, s_axi_arburst};
  assign w  = {s_axi_wlast, s_axi_wstrb, s_axi_wdata};
  assign b  = {s_axi_bid, s_axi_bresp};
  assign r  = {s_axi_rid, s_axi_rresp, s_axi_rlast, s_axi_rdata};

  logic aw_moves, w_moves, b_moves, ar_moves, r_moves, r_ends;
  assign aw_moves = s_axi_awvalid && s_axi_awready;
  assign w_moves  = s_axi_wvalid && s_axi_wready;
  assign b_moves  = s_axi_bvalid && s_axi_bready;
  assign ar_moves = s_axi_arvalid && s_axi_arready;
  assign r_moves  = s_axi_rvalid && s_axi_rready;
  assign r_ends   = r_moves && s_axi_rlast;

  // ---- In reset nothing is valid; what is valid stays, and stays the same, until it is taken ----

  // The last edge was one of a reset, or not.
  logic in_reset_q = 1'b0;
  logic awake_q = 1'b0;
  logic aw_waits_q, w_waits_q, b_waits_q, ar_waits_q, r_waits_q;
  burst_t aw_q, ar_q;
  beat_t   w_q;
  done_t   b_q;
  answer_t r_q;

  always_ff @(posedge clk_i) begin
    in_reset_q <= !rst_ni;
    awake_q <= rst_ni && (awake_q || in_reset_q);
    aw_waits_q <= s_axi_awvalid && !s_axi_awready;
    w_waits_q <= s_axi_wvalid && !s_axi_wready;
    b_waits_q <= s_axi_bvalid && !s_axi_bready;
    ar_waits_q <= s_axi_arvalid && !s_axi_arready;
    r_waits_q <= s_axi_rvalid && !s_axi_rready;
    aw_q <= aw;
    w_q <= w;
    b_q <= b;
    ar_q <= ar;
    r_q <= r;
  end

  always_ff @(posedge clk_i) begin
    if (in_reset_q) begin
      silent_slave : assert (!s_axi_bvalid && !s_axi_rvalid);
      silent_master : assume (!s_axi_awvalid && !s_axi_wvalid && !s_axi_arvalid);
    end
    if (awake_q && rst_ni) begin
      if (b_waits_q) stable_b : assert (s_axi_bvalid && b == b_q);
      if (r_waits_q) stable_r : assert (s_axi_rvalid && r == r_q);
      if (aw_waits_q) stable_aw : assume (s_axi_awvalid && aw == aw_q);
      if (w_waits_q) stable_w : assume (s_axi_wvalid && w == w_q);
      if (ar_waits_q) stable_ar : assume (s_axi_arvalid && ar == ar_q);
    end
  end

  // ---- Bursts ----

  function automatic logic is_legal(burst_t burst);
    logic [ADDR_BITS-1:0] within_beat;
    logic [12:0] span;
    logic wraps;
    within_beat = ~(ADDR_BITS'('1) << burst.size);
    span = (13'(burst.len) + 13'd1) << burst.size;
    wraps = burst.len == 8'd1 || burst.len == 8'd3 || burst.len == 8'd7 || burst.len == 8'd15;
    if (2 ** 32'(burst.size) > STRB_BITS) return 1'b0;
    unique case (burst.burst)
      2'b00:   return burst.len < 8'd16;
      // It stays within 4 KiB.
      2'b01:   return 32'(12'(burst.addr & ~within_beat)) + 32'(span) <= 4096;
      2'b10:   return wraps && (burst.addr & within_beat) == '0;
      default: return 1'b0;
    endcase
  endfunction

  // Bursts that are under way, the oldest first: what was said of them when they were asked for, and how many beats
  // of them there were.
  logic [ID_BITS-1:0] write_ids_q[OUTSTANDING], read_ids_q[OUTSTANDING];
  logic [7:0] write_lens_q[OUTSTANDING], data_lens_q[OUTSTANDING], read_lens_q[OUTSTANDING];
  logic [COUNT_BITS-1:0] writes_q, datas_q, reads_q;
  logic [8:0] data_beats_q, read_beats_q;

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      writes_q <= '0;
      datas_q <= '0;
      reads_q <= '0;
      data_beats_q <= '0;
      read_beats_q <= '0;
    end else begin
      writes_q <= writes_q + COUNT_BITS'(aw_moves) - COUNT_BITS'(b_moves);
      datas_q  <= datas_q + COUNT_BITS'(w_moves && s_axi_wlast) - COUNT_BITS'(b_moves);
      reads_q  <= reads_q + COUNT_BITS'(ar_moves) - COUNT_BITS'(r_ends);
      if (w_moves) data_beats_q <= s_axi_wlast ? '0 : data_beats_q + 1'b1;
      if (r_moves) read_beats_q <= s_axi_rlast ? '0 : read_beats_q + 1'b1;
    end
  end

  for (genvar i = 0; i < OUTSTANDING; i++) begin : gen_queue
    localparam int unsigned NEXT = i + 1 < OUTSTANDING ? i + 1 : i;
    always_ff @(posedge clk_i) begin
      if (aw_moves && 32'(writes_q) - 32'(b_moves) == i) begin
        write_ids_q[i]  <= s_axi_awid;
        write_lens_q[i] <= s_axi_awlen;
      end else if (b_moves) begin
        write_ids_q[i]  <= write_ids_q[NEXT];
        write_lens_q[i] <= write_lens_q[NEXT];
      end
      if (w_moves && s_axi_wlast && 32'(datas_q) - 32'(b_moves) == i) data_lens_q[i] <= data_beats_q[7:0];
      else if (b_moves) data_lens_q[i] <= data_lens_q[NEXT];
      if (ar_moves && 32'(reads_q) - 32'(r_ends) == i) begin
        read_ids_q[i]  <= s_axi_arid;
        read_lens_q[i] <= s_axi_arlen;
      end else if (r_ends) begin
        read_ids_q[i]  <= read_ids_q[NEXT];
        read_lens_q[i] <= read_lens_q[NEXT];
      end
    end

    // As soon as both are known.
    always_ff @(posedge clk_i) begin
      if (rst_ni && awake_q && i < 32'(writes_q)) begin
        if (i < 32'(datas_q)) beats_of_write : assume (data_lens_q[i] == write_lens_q[i]);
        if (i == 32'(datas_q)) rest_of_write : assume (data_beats_q <= 9'(write_lens_q[i]));
      end
    end
  end

  always_ff @(posedge clk_i) begin
    if (rst_ni && awake_q) begin
      if (s_axi_awvalid) legal_aw : assume (is_legal(aw));
      if (s_axi_arvalid) legal_ar : assume (is_legal(ar));
      if (aw_moves) room_for_aw : assert (32'(writes_q) < OUTSTANDING);
      if (w_moves) room_for_w : assert (32'(datas_q) < OUTSTANDING);
      if (ar_moves) room_for_ar : assert (32'(reads_q) < OUTSTANDING);
      if (s_axi_bvalid) begin
        asked_b : assert (writes_q != '0 && datas_q != '0);
        id_of_b : assert (s_axi_bid == write_ids_q[0]);
        legal_b : assert (s_axi_bresp != 2'b01);
      end
      if (s_axi_rvalid) begin
        asked_r : assert (reads_q != '0);
        id_of_r : assert (s_axi_rid == read_ids_q[0]);
        last_of_r : assert (s_axi_rlast == (read_beats_q == 9'(read_lens_q[0])));
        legal_r : assert (s_axi_rresp != 2'b01);
      end
    end
  end

endmodule

bind pearl_axi_slave axi_properties #(
    .DATA_WL  (DATA_WL),
    .ADDR_BITS(ADDR_BITS),
    .ID_BITS  (ID_BITS)
) u_properties (.*);
